"""Figures of merit that tests name by their import path."""

import os
import time

import numpy as np


def power(point):
    """Laser power, W."""
    return point.scene.laser.power


def drawn(point):
    """A random number that depends on the point's seed, with an error."""
    return np.random.default_rng(point.seed).random(), 0.25


def not_finite(point):
    return float("nan")


def fragile(point):
    if point.scene.laser.power > 3e-3:
        raise RuntimeError("too\nbright")
    return 1.0


def deadly(point):
    """End the process at one power."""
    if point.scene.laser.power == 5e-3:
        os._exit(9)
    return point.scene.laser.power


def ends(point):
    raise SystemExit("no licence")


def slow(point):
    time.sleep(0.02)
    return point.scene.laser.power


def energy(point):
    return point.scene.laser.power * point.scene.camera.exposure


def off(point, power, exposure=1.0):
    """Squared distance of the power in mW and the exposure in s from a point."""
    scene = point.scene
    return (1e3 * scene.laser.power - power) ** 2 + (scene.camera.exposure - exposure) ** 2


def between(point):
    """Distance of the power in mW from the exposure in s."""
    return abs(1e3 * point.scene.laser.power - point.scene.camera.exposure)


def narrow(point):
    """The power, which the process does not survive or refuses beyond a limit."""
    if point.scene.laser.power > 6e-3:
        raise RuntimeError("too bright")
    return point.scene.laser.power


def steps(point, pace=0.0):
    """Distance of the stop number from 5 in octaves, and more for one of two pictures."""
    time.sleep(pace)
    scene = point.scene
    dark = float(scene.hidden.reflectance.mean() < 0.1)
    number = scene.camera.focal_length / scene.camera.stop_diameter
    return abs(np.log2(number / 5.0)) + dark
