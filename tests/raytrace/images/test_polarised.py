"""Polarised light: closed forms, and an integral over points with fields as vectors in space."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.kernels.polarisation import fresnel
from nlosoptics.raytrace import trace_polarised
from nlosoptics.scene import (
    Camera,
    FlatWall,
    Lambert,
    Laser,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
)

PAINT, METAL = 1.5, 1.45 + 7.54j
UP = (0.0, 1.0, 0.0)
BREWSTER = math.atan(PAINT)


def room(**changes):
    scene = Scene(
        Laser(wavelength=633e-9, power=2.0, beam_diameter=0.02, position=(-0.1, 0.5, 0.9)),
        FlatWall(size=(1.6, 1.2)),
        PlanarObject(np.ones((2, 2)), 0.5, position=(0.35, 0.0, 0.6), yaw=0.3),
        Camera(
            position=(-0.3, 0.1, 1.0),
            aim=(0.0, -0.1, 0.0),
            focal_length=0.1,
            stop_diameter=0.1,
            pixel_pitch=1e-2,
            pixels=(8, 8),
            binning=1,
            focus_distance=1.5,
        ),
        wall_material=SumMaterial(Lambert(0.3), SpecularMicrofacet(0.5, 0.3, index=METAL)),
    )
    thing = SumMaterial(Lambert(0.3), SpecularMicrofacet(0.4, 0.25, index=PAINT))
    return replace(scene, hidden=replace(scene.hidden, material=thing), **changes)


def total(image, name="power"):
    """Return the sums over pixels of the four Stokes parameters, and their standard errors."""
    sums = image.groups[:, 1 if name == "power" else 0].sum(axis=(1, 2))
    assert sums.mean(axis=0) == approx(getattr(image, name).sum(axis=(1, 2)), rel=1e-12)
    return sums.mean(axis=0), sums.std(axis=0, ddof=1) / math.sqrt(len(sums))


def amplitudes(index, cosine):
    """Return Fresnel's r_s and r_p by the angle of refraction."""
    cos_t = np.sqrt(1 - (1 - cosine**2) / index**2 + 0j)
    cos_t = np.where(cos_t.imag < 0, -cos_t, cos_t)
    return (
        (cosine - index * cos_t) / (cosine + index * cos_t),
        (index * cosine - cos_t) / (index * cosine + cos_t),
    )


def outer(a, b):
    return a[:, :, None] * b[:, None, :]


def unit(v):
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / length, length[..., 0]


def reflected(material, tensor, to, out, normal):
    """Return f_r times the tensor <E_a E_b*> of light that a material reflects."""
    body, gloss = material.parts
    trace = np.trace(tensor, axis1=1, axis2=2)
    f = body.evaluate(-to, out, normal)[:, None, None]
    result = 0.5 * f * trace[:, None, None] * (np.eye(3) - outer(out, out))
    half, _ = unit(out - to)
    cosine = (half * out).sum(axis=1)
    r_s, r_p = amplitudes(gloss.index, cosine)
    s, _ = unit(np.cross(half, to))
    p_in, p_out = np.cross(s, to), np.cross(s, out)
    jones = r_s[:, None, None] * outer(s, s) + r_p[:, None, None] * outer(p_out, p_in)
    mean = 0.5 * (abs(r_s) ** 2 + abs(r_p) ** 2)
    f = (gloss.evaluate(-to, out, normal) / mean)[:, None, None]
    return result + f * (jones @ tensor @ np.conj(np.swapaxes(jones, 1, 2)))


def clear(scene, a, b):
    """Return whether the object leaves the lines from points a to points b open."""
    corners = np.asarray(scene.hidden.corners).reshape(4, 3)
    along, across = corners[1] - corners[0], corners[3] - corners[0]
    normal = np.cross(along, across)
    share = ((corners[0] - a) @ normal) / ((b - a) @ normal)
    at = a + share[:, None] * (b - a) - corners[0]
    u, v = at @ along / (along @ along), at @ across / (across @ across)
    inside = (u > 0) & (u < 1) & (v > 0) & (v < 1)
    return ~(inside & (share > 0) & (share < 1))


def integral(scene, field, bounces, count, seed):
    """Return the Stokes parameters of light with 1 or 3 reflections, by points spread evenly."""
    draw, camera, laser = np.random.default_rng(seed), scene.camera, scene.laser
    right, up, axis = camera.frame
    beam, _ = unit(np.subtract(laser.aim, laser.position))
    side, _ = unit(np.cross(beam, (1.0, 0.0, 0.0)))

    def disc(radius, first, second):
        r, t = radius * np.sqrt(draw.random(count)), 2 * math.pi * draw.random(count)
        return (
            outer((r * np.cos(t))[:, None], first[None])[:, 0]
            + outer((r * np.sin(t))[:, None], second[None])[:, 0]
        )

    start = laser.position + disc(laser.beam_diameter / 2, side, np.cross(beam, side))
    points = [start - start[:, 2:] / beam[2] * beam]
    normals, materials = [np.array((0.0, 0.0, 1.0))], [scene.wall_material]
    weight = np.full(count, laser.power)
    if bounces == 3:
        size, thing = np.array(scene.hidden.size), scene.hidden
        corners = np.asarray(thing.corners).reshape(4, 3)
        along, across = corners[1] - corners[0], corners[3] - corners[0]
        u, v = draw.random((2, count, 1))
        points.append(corners[0] + u * along + v * across)
        facing, _ = unit(np.cross(along, across))
        normals.append(facing * -np.sign(facing[2]))
        x, y = scene.wall.size
        flat = (draw.random((count, 2)) - 0.5) * (x, y)
        points.append(np.column_stack([flat, np.zeros(count)]))
        normals.append(normals[0])
        materials += [thing.material, scene.wall_material]
        weight *= size.prod() * x * y
    lens = camera.position + disc(camera.stop_diameter / 2, right, up)
    weight *= math.pi * camera.stop_diameter**2 / 4 * camera.transmission
    points.append(lens)
    weight *= clear(scene, start, points[0]) & clear(scene, points[-2], lens)
    to = np.broadcast_to(beam, (count, 3))
    field, _ = unit(np.subtract(field, np.dot(field, beam) * beam))
    tensor = np.broadcast_to(np.outer(field, field).astype(complex), (count, 3, 3))
    for k in range(bounces):
        out, r = unit(points[k + 1] - points[k])
        tensor = reflected(materials[k], tensor, to, out, normals[k])
        arriving = -(out @ axis) if k + 1 == bounces else -(out * normals[k + 1]).sum(axis=1)
        leaving = (out * normals[k]).sum(axis=1)
        weight = weight * np.maximum(leaving, 0) * np.maximum(arriving, 0) / r**2
        to = out
    # pixel by the plane in focus, see the page on images
    a, b, c = (-(to @ v) for v in camera.frame)
    s = scene.focus_distance
    p = lens - np.array(camera.position)
    half = 4 * camera.pixel_pitch
    for v, cosine in ((right, a), (up, b)):
        weight = weight * (abs(scene.image_distance / s * (p @ v + s / c * cosine)) < half)
    first, _ = unit(right - (to @ right)[:, None] * to)
    second = np.cross(first, to)
    second *= np.sign(second @ up)[:, None]
    j11, j22, j12 = (
        np.einsum("ni,nij,nj->n", x, tensor, y)
        for x, y in ((first, first), (second, second), (first, second))
    )
    stokes = np.stack([(j11 + j22).real, (j11 - j22).real, 2 * j12.real, 2 * j12.imag])
    values = stokes * weight
    return values.mean(axis=1), values.std(axis=1) / math.sqrt(count)


@pytest.mark.parametrize("field", [UP, (1.0, 0.5, 0.2)])
def test_stokes_parameters_agree_with_an_integral_of_field_tensors(field):
    """Other formulas and other samples; all four Stokes parameters differ from 0."""
    scene = room()
    image = trace_polarised(scene, laser_axis=field, n_rays=1 << 17, max_bounces=3, seed=7)
    for name, bounces in (("power", 3), ("stray", 1)):
        found, error = total(image, name)
        exact, rest = integral(scene, field, bounces, 400_000, seed=11)
        # five standard errors of both
        assert (abs(found - exact) < 5 * np.hypot(error, rest)).all(), (name, found, exact)
        assert (abs(exact) > 10 * rest)[[0, 1]].all()


def test_a_perfect_conductor_reflects_the_field_of_electromagnetism():
    """E' = 2 n (n E) - E for an infinite index: signs of both amplitudes."""
    assert fresnel(1e4, 1e4, 0.6) == approx((1.0, 0.0, -1.0, 0.0), abs=1e-3)
    r_s, r_p = amplitudes(1e4 + 1e4j, np.array(0.6))
    d, out, normal = np.array((0.8, 0, -0.6)), np.array((0.8, 0, 0.6)), np.array((0, 0, 1.0))
    s = np.cross(normal, d) / 0.8
    for e in (s, np.cross(s, d), 0.6 * s + 0.8 * np.cross(s, d)):
        field = r_s * (e @ s) * s + r_p * (e @ np.cross(s, d)) * np.cross(s, out)
        assert field == approx(2 * normal * (normal @ e) - e, abs=1e-3)


@pytest.mark.parametrize("index", [PAINT, METAL, 0.2 + 3j])
def test_fresnel_matrices_are_pure_and_reflect_at_most_all_light(index):
    """a^2 - b^2 = c^2 + d^2 of a matrix that depolarises nothing; a + |b| <= 1."""
    for angle in np.linspace(0.0, 1.57, 20):
        a, b, c, d = fresnel(complex(index).real, complex(index).imag, math.cos(angle))
        r_s, r_p = amplitudes(index, np.array(math.cos(angle)))
        assert a + b == approx(float(abs(r_s) ** 2), rel=1e-9)
        assert a - b == approx(float(abs(r_p) ** 2), rel=1e-9, abs=1e-15)
        assert a * a - b * b == approx(c * c + d * d, rel=1e-9, abs=1e-15)
        assert a + abs(b) <= 1.0 + 1e-12


def mirror(angle, material):
    """Return a scene in which a smooth wall reflects the beam into the lens at an angle."""
    x, z = math.sin(angle), math.cos(angle)
    scene = room(wall_material=material)
    camera = replace(
        scene.camera, position=(x, 0.0, z), aim=(0.0, 0.0, 0.0), pixel_pitch=1e-3, pixels=(64, 64)
    )
    return replace(scene, laser=replace(scene.laser, position=(-x, 0.0, z)), camera=camera)


def test_a_mirror_at_brewsters_angle_removes_one_polarisation():
    """The plane of incidence is y = 0; the camera's e1 lies in it, and e2 along y."""
    scene = mirror(BREWSTER, SpecularMicrofacet(0.1, 0.0, index=PAINT))
    full = 2.0 * 0.1 * scene.camera.transmission
    within, across = np.cross(UP, scene.laser.position), UP
    for field, expected in ((within, 0.0), (across, 2 * full), (None, full)):
        image = trace_polarised(scene, laser_axis=field, n_rays=256, max_bounces=1)
        found = image.stray.sum(axis=(1, 2))
        assert found[0] == approx(expected, abs=1e-9 * full)
        assert found[1] == approx(-expected, abs=1e-9 * full)
        assert image.paths.stray == approx(full, rel=1e-12)


def test_a_polarised_mirror_image_obeys_malus():
    scene = mirror(0.5, SpecularMicrofacet(0.1, 0.0, index=PAINT))
    image = trace_polarised(scene, laser_axis=UP, n_rays=256, max_bounces=1)
    bright = image.stray[0].sum()
    for angle in np.linspace(0.0, 3.0, 7):
        seen, _ = image.through(angle, stray=True)
        # the rays are parallel and perpendicular to e1 and e2
        assert seen.sum() == approx(bright * math.sin(angle) ** 2, abs=1e-9 * bright)


def test_crossed_polarisers_separate_gloss_from_body():
    """The body is as bright through both; the difference is the gloss alone."""
    gloss = SpecularMicrofacet(0.1, 0.05, index=PAINT)
    options = {"laser_axis": UP, "n_rays": 1 << 14, "max_bounces": 1, "seed": 3}
    both = mirror(0.5, SumMaterial(Lambert(0.6), gloss))
    image = trace_polarised(both, **options)
    (along, _), (crossed, _) = (image.through(x, stray=True) for x in (math.pi / 2, 0.0))
    alone = trace_polarised(mirror(0.5, gloss), **options)
    matt = trace_polarised(mirror(0.5, Lambert(0.6)), **options)
    q, error = total(alone, "stray")
    matt_power, matt_error = total(matt, "stray")
    spread = math.hypot(error[1], total(image, "stray")[1][1])
    assert along.sum() - crossed.sum() == approx(-q[1], abs=4 * spread)
    # crossed: half the body, and what facets out of the plane turn, less than 1e-3 of the gloss
    limit = 4 * math.hypot(matt_error[0], total(image, "stray")[1][0]) + 1e-3 * q[0]
    assert crossed.sum() == approx(0.5 * matt_power[0], abs=limit)
    assert (matt.stray[1:] == 0.0).all()


def test_a_mirror_polarises_the_image_of_a_matt_object():
    """Spot, object, mirror, lens: only the mirror's part is polarised, by its angle."""
    scene = room(wall_material=SumMaterial(Lambert(0.4), SpecularMicrofacet(0.3, 0.0, index=PAINT)))
    scene = replace(
        scene,
        hidden=replace(scene.hidden, size=(0.04, 0.04), material=Lambert(0.8)),
        camera=replace(
            scene.camera, stop_diameter=0.01, aim=(0.106, 0.0375, 0.0), pixel_pitch=1e-3
        ),
    )
    options = {"laser_axis": UP, "n_rays": 1 << 15, "max_bounces": 3, "seed": 9}
    found, error = total(trace_polarised(scene, **options))
    matt, rest = total(trace_polarised(replace(scene, wall_material=Lambert(0.4)), **options))
    mirrored, spread = found[0] - matt[0], math.hypot(error[0], rest[0])
    assert mirrored > 10 * spread
    position = np.array(scene.hidden.position) * (1, 1, -1)
    way, _ = unit(np.subtract(scene.camera.position, position))
    a, b, _, _ = fresnel(PAINT, 0.0, way[2])
    normal, right = np.cross((0.0, 0.0, 1.0), way), scene.camera.frame[0]
    first, _ = unit(right - (right @ way) * way)
    double = 2 * (unit(normal)[0] @ first) ** 2 - 1
    # the angle varies by the object's half width of 0.02 m at 1.7 m, b/a by some 3 %
    assert found[1] == approx(mirrored * b / a * double, rel=0.03, abs=4 * spread * b / a)
    assert abs(found[1]) > 10 * spread * b / a


def test_mirrors_before_and_after_a_matt_object():
    """Laser, mirror, object, mirror, lens: the first mirror scales, the last one polarises."""
    scene = room(wall_material=SpecularMicrofacet(0.5, 0.0, index=PAINT))
    scene = replace(
        scene,
        hidden=replace(scene.hidden, position=(0.0, 0.0, 0.8), yaw=0.0, material=Lambert(0.8)),
        laser=replace(scene.laser, position=(-0.6, 0.0, 0.9), aim=(-0.25, 0.0, 0.0)),
        camera=replace(scene.camera, position=(0.7, 0.0, 0.7), aim=(0.3, 0.0, 0.0)),
    )
    plain = trace_polarised(scene, n_rays=1 << 17, max_bounces=3, seed=1)
    turned = trace_polarised(scene, n_rays=1 << 17, max_bounces=3, seed=1, laser_axis=UP)
    beam, _ = unit(np.subtract(scene.laser.aim, scene.laser.position))
    a, b, _, _ = fresnel(PAINT, 0.0, -float(beam[2]))
    (first, _), (second, _) = total(plain), total(turned)
    assert first[0] > 0.0
    assert any("does not solve for reflection points" in text for text in plain.paths.unreached)
    # the beam is parallel, so that all rays meet the wall at one angle, by the same rays
    assert second == approx(first * (1 + b / a), rel=1e-9, abs=1e-12 * first[0])
    # angles at the last mirror: from the object's mirror image to the lens
    corners = np.asarray(scene.hidden.corners).reshape(-1, 3) * (1, 1, -1)
    rim = np.array(scene.camera.position) + 0.05 * np.array(
        [[math.cos(t), math.sin(t), 0] for t in np.linspace(0, 6, 9)]
    )
    ways, _ = unit((rim[:, None] - corners).reshape(-1, 3))
    shares = [m[1] / m[0] for m in (fresnel(PAINT, 0.0, way[2]) for way in ways)]
    assert -max(shares) < first[1] / first[0] < -min(shares) * 0.5


def test_threads_and_blocks_change_no_bit(monkeypatch):
    from nlosoptics.raytrace.light import trace as tracing

    found = trace_polarised(room(), laser_axis=UP, n_rays=9000, seed=5, max_bounces=4)
    monkeypatch.setattr(tracing, "BLOCK", 1024)
    again = trace_polarised(room(), laser_axis=UP, n_rays=9000, seed=5, max_bounces=4)
    assert np.array_equal(found.power, again.power)
    assert found.power[0].sum() > 0.0


def test_unknown_polarisation_is_refused():
    ward = SumMaterial(Lambert(0.3), Ward(0.1, 0.2))
    with pytest.raises(SceneError, match="wall_material has a glossy lobe without a refractive"):
        trace_polarised(room(wall_material=ward), n_rays=100)
    along = tuple(np.subtract(room().laser.aim, room().laser.position))
    with pytest.raises(SceneError, match=r"laser_axis = .* is parallel to the beam"):
        trace_polarised(room(), n_rays=100, laser_axis=along)
    for index, told in ((1.0, "nothing is reflected"), (1 - 1j, "out of range"), ("a", "give a")):
        with pytest.raises(SceneError, match=told):
            SpecularMicrofacet(0.1, 0.0, index=index)


def test_a_file_restores_the_index(tmp_path):
    scene = room()
    scene.save(tmp_path / "room.toml")
    assert Scene.load(tmp_path / "room.toml") == scene
    assert scene.wall_material.parts[1].index == METAL
