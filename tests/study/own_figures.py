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


def slow(point):
    time.sleep(0.02)
    return point.scene.laser.power


def energy(point):
    return point.scene.laser.power * point.scene.camera.exposure
