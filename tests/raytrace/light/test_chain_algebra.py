"""Equations of mirror chains: their Newton steps, their Jacobian, and where surfaces end."""

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics.raytrace.intersection.intersections import compiled_wall
from nlosoptics.raytrace.light import _chain_kernels as chains
from nlosoptics.raytrace.light._surround_kernels import OBJECT, WALL
from nlosoptics.scene import ConcaveWall, SumWall, WavyWall

WORLD = np.array([0.0, 0.0, 0.0, *np.eye(3).ravel()])


def compiled(wall):
    terms, tables, _, box, _, rim = compiled_wall(wall, math.inf)
    return terms, tables, box, rim


def frame(origin, normal, turn):
    """Origin, two axes and normal of a plane whose axes are turned about its normal."""
    n = np.array(normal) / np.linalg.norm(normal)
    a = np.cross(n, (0.3, 1.0, -0.2))
    a /= np.linalg.norm(a)
    b = np.cross(n, a)
    first = math.cos(turn) * a + math.sin(turn) * b
    return np.concatenate([origin, first, np.cross(n, first), n])


@pytest.mark.parametrize("m", [1, 2, 3, 5])
def test_newton_step_solves_the_whole_system(m):
    """Against the dense matrix of all blocks."""
    draw = np.random.default_rng(m)
    own, back, ahead = draw.normal(size=(3, m, 2, 2))
    g, step = draw.normal(size=(m, 4)), np.empty((m, 2))
    dense = np.zeros((m, 2, m, 2))
    for i in range(m):
        dense[i, :, i] = own[i]
        if i > 0:
            dense[i, :, i - 1] = back[i]
        if i < m - 1:
            dense[i, :, i + 1] = ahead[i]
    dense = dense.reshape(2 * m, 2 * m)
    found = chains._steps(g, own, back, ahead, step)
    assert found == approx(np.linalg.det(dense), rel=1e-10)
    assert step.ravel() == approx(np.linalg.solve(dense, -g[:, 2:].ravel()), rel=1e-9)


CASES = {
    "wall": (WALL,),
    "object and wall": (OBJECT, WALL),
    "wall, object, wall": (WALL, OBJECT, WALL),
}


def chain(kinds, seed):
    """Frames, slopes and coordinates of a chain that is near none of its solutions."""
    draw = np.random.default_rng(seed)
    plate = frame((0.3, 0.1, 0.6), (-0.2, 0.1, -1.0), 0.4)
    frames = np.array([WORLD if kind == WALL else plate for kind in kinds])
    return frames, draw.normal(0, 0.1, (len(kinds), 2)), draw.normal(0, 0.1, (len(kinds), 2))


@pytest.mark.parametrize("kinds", CASES.values(), ids=CASES)
def test_jacobian_is_the_slope_of_the_equations(kinds):
    """Central differences of the equations by every coordinate, on a wall without symmetry."""
    walls = compiled(SumWall(WavyWall(0.02, 0.4, 0.3, direction=0.7), ConcaveWall(3.0), size=2.0))
    a, p, m, h = (-0.3, 0.2, 0.7), (0.4, -0.3, 0.5), len(kinds), 1e-5
    frames, slopes, u = chain(kinds, seed=3)

    def equations(u):
        x, g, blocks = np.empty((m, 3)), np.empty((m, 4)), np.zeros((3, m, 2, 2))
        total = chains._equations(walls, np.array(kinds), frames, slopes, a, p, u, x, g, *blocks)
        assert total == approx((g[:, 2:] ** 2).sum(), rel=1e-14)
        return g[:, 2:].copy(), blocks

    _, (own, back, ahead) = equations(u)
    for j in range(m):
        for q in range(2):
            move = np.zeros((m, 2))
            move[j, q] = h
            slope = (equations(u + move)[0] - equations(u - move)[0]) / (2 * h)
            for i in range(m):
                block = {-1: back, 0: own, 1: ahead}.get(j - i)
                here = np.zeros(2) if block is None else block[i, :, q]
                assert here == approx(slope[i], rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_plane_mirrors_reflect_where_their_images_say(m):
    walls = compiled(WavyWall(1e-15, 1.0, size=4.0))
    kinds = np.array([WALL, OBJECT, WALL])[:m]
    frames, _, u = chain(kinds, seed=4)
    a, p = (-0.3, 0.2, 0.4), ((0.5, -0.3, 0.3) if m != 2 else (0.6, 0.2, 0.1))
    chains._unfold(frames, a, p, u)
    x, g, blocks = np.empty((m, 3)), np.empty((m, 4)), np.zeros((3, m, 2, 2))
    slopes = np.zeros((m, 2))
    assert chains._equations(walls, kinds, frames, slopes, a, p, u, x, g, *blocks) < 1e-24
    path = [a, *x, p]
    for i in range(1, m + 1):
        before, after = path[i - 1] - x[i - 1], path[i + 1] - x[i - 1]
        before, after = before / np.linalg.norm(before), after / np.linalg.norm(after)
        assert np.cross(before + after, frames[i - 1, 9:]) == approx(np.zeros(3), abs=1e-12)
