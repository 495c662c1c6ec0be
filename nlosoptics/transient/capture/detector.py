"""The detector of a time-resolved capture: gate, jitter, dark counts, photon noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, in_range, positive, real
from ..._random import checked_seed
from ...errors import SceneError
from .capture import TransientCapture

Array = NDArray[np.floating]

#: Lengths below it, m, can only be seconds: 0.1 um of path is 0.3 fs.
FINEST = 1e-7
#: Beyond these, standard deviations and tail lengths, less than 1e-14 of the light arrives.
SIGMAS, TAILS = 8.0, 33.0
#: Means beyond it lose whole counts to the rounding of doubles.
MOST_COUNTS = 2.0**50


@dataclass(frozen=True, kw_only=True)
class Detector:
    """A counting detector, such as a SPAD with its clock, far from saturation.

    Lengths are of optical path: 50 ps are 0.015 m. Photons pile up nowhere, nor does one blind the
    detector for the next: that holds below some 5 % detections a pulse.

    Parameters
    ----------
    photons : float, optional
        Expected photons that the whole capture (all bins of all points) brings to the detector
        before its gate; by default ``H`` itself is photons.
    efficiency : float
        Share of the photons that is counted, 0 to 1.
    jitter : float
        Standard deviation of the Gaussian part of the time stamps' errors, m of optical path.
    tail : float
        Mean delay of the diffusion tail, m of optical path; its counts have the Gaussian too.
    tail_share : float
        Share of the counts that are in the tail, 0 to 1.
    dark_counts : float
        Expected in each bin of each point, after ``efficiency``; as long as the gate is open.
    gate : (float, float), optional
        m of optical path between which the detector counts what arrives; time stamps may err out
        of it. Always open by default.

    Raises
    ------
    SceneError
        If a value is out of range, or a length can only be in seconds.
    """

    photons: float | None = None
    efficiency: float = 1.0
    jitter: float = 0.0
    tail: float = 0.0
    tail_share: float = 0.0
    dark_counts: float = 0.0
    gate: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        if self.photons is not None:
            put(self, "photons", positive("detector.photons", self.photons))
        for name in ("efficiency", "tail_share"):
            put(self, name, in_range(f"detector.{name}", getattr(self, name), 0.0, 1.0))
        for name in ("jitter", "tail"):
            length = in_range(f"detector.{name}", getattr(self, name), 0.0, unit="m")
            if 0.0 < length < FINEST:
                raise SceneError(
                    f"detector.{name} = {length:g} is too short for m of optical path, limit "
                    f"{FINEST:g} m: as seconds it would be {length * 299792458.0:.6g}; give m"
                )
            put(self, name, length)
        if (self.tail > 0.0) != (self.tail_share > 0.0):
            raise SceneError(
                f"detector.tail = {self.tail:g} m with tail_share = {self.tail_share:g} is no "
                "tail; give both above 0, or neither"
            )
        put(self, "dark_counts", in_range("detector.dark_counts", self.dark_counts, 0.0))
        if self.gate is not None:
            if not isinstance(self.gate, tuple | list) or len(self.gate) != 2:
                raise SceneError(f"detector.gate = {self.gate!r} must be (opens, closes) in m")
            opens, closes = (real("detector.gate", value) for value in self.gate)
            if not closes > opens:
                raise SceneError(
                    f"detector.gate closes at {closes:g} m, must be after {opens:g} m, where it "
                    "opens"
                )
            put(self, "gate", (opens, closes))

    @property
    def mean_delay(self) -> float:
        """Mean error of a time stamp, m of optical path."""
        return self.tail_share * self.tail

    @property
    def spread(self) -> float:
        """Standard deviation of a time stamp's error, m of optical path."""
        tail = self.tail_share * (2.0 - self.tail_share) * self.tail**2
        return math.sqrt(self.jitter**2 + tail)

    def expected(self, capture: TransientCapture) -> Array:
        """Mean counts of every bin, in the capture's shape.

        Light counts as even over each bin, of which the gate may cut a part. Counts whose time
        stamps err beyond the capture's first or last bin are lost.

        Raises
        ------
        SceneError
            If the capture has bins below 0, or no light where ``photons`` are wanted.
        """
        H = capture.H
        lowest = float(H.min())
        if lowest < 0.0:
            raise SceneError(
                f"the capture has a bin of {lowest:g}, which is no light; counts are taken of a "
                "capture without negative bins"
            )
        fits_memory("detector", 3 * 8.0 * H.size, "take the capture in parts")
        share = self.efficiency
        if self.photons is not None:
            total = float(H.sum(dtype=np.float64))
            if not total > 0.0:
                raise SceneError(
                    f"the capture has no light, detector.photons = {self.photons:g} cannot come of "
                    "it; leave photons out or check the capture"
                )
            share *= self.photons / total
        open_share = self._open_share(capture).reshape(-1, *[1] * (H.ndim - 1))
        means = H * (share * open_share)
        if self.jitter or self.tail:
            means = self._stamped(means, capture.delta_t)
        return np.asarray(means + self.dark_counts * open_share)

    def measure(self, capture: TransientCapture, seed: int = 0) -> TransientCapture:
        """Counts of one measurement.

        Each bin draws from the seed and its own index: the same bits on any number of threads.

        Parameters
        ----------
        capture : TransientCapture
        seed : int

        Returns
        -------
        TransientCapture
            Of ``quantity="counts"``, with the standard error of each bin, the root of its mean.
            Counts do not tell bounces apart.

        Raises
        ------
        SceneError
            See `expected`; or if counts are too many to be told apart.
        """
        from . import _detector_kernels

        key = checked_seed(seed)
        means = self.expected(capture)
        most = float(means.max())
        if most > MOST_COUNTS:
            raise SceneError(
                f"a bin expects {most:g} counts, limit {MOST_COUNTS:g}; give fewer photons"
            )
        counts = np.empty(means.size)
        _detector_kernels.poisson(means.ravel(), np.uint64(key), counts)
        return replace(
            capture,
            H=counts.reshape(means.shape),
            quantity="counts",
            by_bounce={},
            standard_error=np.sqrt(means),
            details={**capture.details, "detector": self._as_dict(), "detector_seed": key},
        )

    def _as_dict(self) -> dict[str, object]:
        from dataclasses import asdict

        return {name: value for name, value in asdict(self).items() if value is not None}

    def _open_share(self, capture: TransientCapture) -> Array:
        """Share of each bin in which the gate is open, (n_bins,)."""
        if self.gate is None:
            return np.ones(capture.n_bins)
        inside = np.clip(capture.edges, *self.gate)
        return np.asarray(np.diff(inside) / capture.delta_t)

    def _stamped(self, means: Array, step: float) -> Array:
        """Counts by their time stamps: convolved with the response along the first axis."""
        from scipy.ndimage import convolve1d
        from scipy.signal import lfilter

        n_bins = means.shape[0]
        response, before, rest = self._response(step, n_bins)
        origin = before - len(response) // 2
        stamped = np.asarray(convolve1d(means, response, axis=0, mode="constant", origin=origin))
        first = len(response) - before
        if rest and first < n_bins:
            # an exponential goes on by itself, whatever its length
            decay = math.exp(-step / self.tail)
            stamped[first:] += rest * lfilter([1.0], [1.0, -decay], means[: n_bins - first], axis=0)
        return stamped

    def _response(self, step: float, n_bins: int) -> tuple[Array, int, float]:
        """Shares of a bin's counts that are stamped so many bins later.

        With the distribution F of errors, light even over a bin lands j bins later with the second
        difference of F's integral at j steps, over the step. Of max(x, 0), the integral without
        errors, that is 1 at 0; the rest is small far from 0, where differences then round to
        nothing.

        Returns
        -------
        response : ndarray
        before : int
            Index of 0.
        rest : float
            Share one bin after the last, from where an exponential goes on; 0 for none.
        """
        reach = SIGMAS * self.jitter
        bend = self.jitter**2 / self.tail if self.tail else 0.0
        before = min(math.ceil(reach / step) + 1, n_bins)
        # where the Gaussian is over, the tail is exponential; a short one is over before
        after = min(math.ceil((reach + min(bend, TAILS * self.tail)) / step) + 2, n_bins)
        at = step * np.arange(-before - 1.0, after + 2.0)
        response = np.diff(self._surplus(at), 2) / step
        response[before] += 1.0
        rest = 0.0
        if self.tail and bend < TAILS * self.tail:
            level = 0.5 * bend / self.tail - step * after / self.tail
            rest = self.tail_share * self.tail / step * math.exp(level)
            rest *= math.expm1(-step / self.tail) ** 2
        # rounding alone takes shares far from 0 below it
        return np.maximum(response, 0.0), before, rest

    def _surplus(self, x: Array) -> Array:
        """Integral of the distribution of errors up to x, less max(x, 0), m.

        Of the Gaussian it is sigma phi(z) - |x| Phi(-|z|), z = x/sigma. The tail's distribution T
        solves T + tail T' = Phi, so that its integral is the Gaussian's less tail T.
        """
        from scipy.special import log_ndtr, ndtr

        sigma, tail = self.jitter, self.tail
        surplus, late = np.zeros(x.shape), np.zeros(x.shape)
        if sigma:
            z = x / sigma
            density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
            surplus = sigma * density - np.abs(x) * ndtr(-np.abs(z))
        if tail and sigma:
            ratio = sigma / tail
            late = ndtr(z) - np.exp(log_ndtr(z - ratio) + 0.5 * ratio**2 - x / tail)
        elif tail:
            late = -np.expm1(-np.maximum(x, 0.0) / tail)
        return np.asarray(surplus - self.tail_share * tail * late)
