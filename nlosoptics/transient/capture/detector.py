"""Detector of a time-resolved capture: gate, dead time, jitter, dark counts and photon noise."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect, fits_memory, in_range, positive, real, whole
from ..._random import checked_seed
from ...errors import SamplingError, SceneError
from .capture import TransientCapture

Array = NDArray[np.floating]

#: Shorter lengths, m, are refused as seconds given by mistake: 0.1 um of path is 0.3 fs.
FINEST = 1e-7
#: Range of the time response, in standard deviations of the Gaussian and in lengths of the tail;
#: less than 1e-14 of the counts lie beyond.
SIGMAS, TAILS = 8.0, 33.0


@dataclass(frozen=True, kw_only=True)
class Detector:
    """Model of a photon counter with time stamps, such as a single-photon avalanche diode (SPAD).

    It turns the bins of a capture into photon counts, with the errors of a real detector. Times are
    given as optical path, m: 50 ps are 0.015 m. After a count the detector is blind for its dead
    time, so that early photons hide later ones (pile-up). That is modelled if the number of laser
    ``pulses`` is given; without it, fewer than about 5 % of the pulses should lead to a count.

    Parameters
    ----------
    photons : float, optional
        Expected number of photons that reach the detector, summed over all bins and points of the
        capture, inside and outside the gate. The capture's signal ``H`` is scaled to this sum.
        None: the values of ``H`` are already photon numbers.
    efficiency : float
        Fraction of the photons that is counted, 0 to 1.
    jitter : float
        Standard deviation of the Gaussian time-stamp error, m of optical path.
    tail : float
        Mean delay of the late counts, m of optical path. Slow carriers in the detector give them an
        exponentially distributed delay (the diffusion tail), in addition to the Gaussian error.
    tail_share : float
        Fraction of the counts that are delayed by the tail, 0 to 1.
    dark_counts : float
        Expected dark counts per bin and point while the gate is open. They do not depend on
        ``efficiency``.
    gate : (float, float), optional
        Opening and closing time of the gate, m of optical path. Photons that arrive outside are
        lost. Recorded time stamps have an error and may lie outside. None: always open.
    pulses : int, optional
        Laser pulses per point over which photons and dark counts are distributed. None: no pile-up.
    dead_time : float
        Time after a count during which there is no other, m of optical path, at least the width of
        a bin. The detector is ready again at the next pulse. By default a pulse has one count at
        most.

    Raises
    ------
    SceneError
        If a value is out of range, or a length is so short that it was probably given in seconds.

    See Also
    --------
    render : Simulated capture of hidden meshes.
    TransientCapture : Time-resolved capture.
    without_pile_up : Correct measured counts.

    Notes
    -----
    A pulse that finds the detector ready in bin k leads to a count there with the probability
    ``1 - exp(-r)``, with r the mean number of photons and dark counts of a pulse in this bin. It is
    ready unless there was a count within the dead time before, on average over both bins [1]_.

    References
    ----------
    .. [1] Coates, J. Phys. E 1 (1968) 878, for one count per pulse.

    Examples
    --------
    >>> from nlosoptics.transient import Detector, TransientCapture
    >>> capture = TransientCapture(
    ...     H=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
    ...     laser_points=(0.0, 0.0, 0.0),
    ...     sensor_points=(0.1, 0.0, 0.0),
    ...     delta_t=0.01,
    ... )
    >>> print(Detector(photons=1000.0, jitter=0.01).expected(capture).round(1))
    [  7.7  66.7 240.8 368.7 240.8  66.7   7.7]

    Two photons in each of 100 pulses lead to at most 100 counts:

    >>> print(Detector(photons=200.0, pulses=100).expected(capture).round(1))
    [ 0.   0.   0.  86.5  0.   0.   0. ]
    """

    photons: float | None = None
    efficiency: float = 1.0
    jitter: float = 0.0
    tail: float = 0.0
    tail_share: float = 0.0
    dark_counts: float = 0.0
    gate: tuple[float, float] | None = None
    pulses: int | None = None
    dead_time: float = math.inf

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
                    f"detector.{name} = {length:g} is too short for a length in m, limit "
                    f"{FINEST:g} m; if it is in seconds, give {length * 299792458.0:.6g} (m)"
                )
            put(self, name, length)
        if (self.tail > 0.0) != (self.tail_share > 0.0):
            raise SceneError(
                f"detector.tail = {self.tail:g} m with tail_share = {self.tail_share:g} is "
                "incomplete; give both above 0, or neither"
            )
        put(self, "dark_counts", in_range("detector.dark_counts", self.dark_counts, 0.0))
        if self.gate is not None:
            if not isinstance(self.gate, tuple | list) or len(self.gate) != 2:
                raise SceneError(
                    f"detector.gate = {self.gate!r} is not a pair, must be (opens, closes) in m"
                )
            opens, closes = (real("detector.gate", value) for value in self.gate)
            if not closes > opens:
                raise SceneError(
                    f"detector.gate closes at {closes:g} m, must be after it opens at {opens:g} m; "
                    "give (opens, closes) in m"
                )
            put(self, "gate", (opens, closes))
        put(self, "dead_time", _checked_dead_time("detector.dead_time", self.dead_time))
        if self.pulses is not None:
            put(self, "pulses", whole("detector.pulses", self.pulses, 1, 1 << 50))
        elif self.dead_time != math.inf:
            raise SceneError(
                f"detector.dead_time = {self.dead_time:g} m without detector.pulses has no effect; "
                "give the number of laser pulses per point"
            )

    def expected(self, capture: TransientCapture) -> Array:
        """Return the expected counts in every bin, without photon noise.

        Parameters
        ----------
        capture : TransientCapture
            Capture with values of at least 0. Within each bin, arrival times are taken as uniformly
            distributed. The gate may open or close inside a bin.

        Returns
        -------
        ndarray
            Mean counts, shaped like ``capture.H``. Counts with time stamps outside the capture's
            bins are lost.

        Raises
        ------
        SceneError
            If a bin is below 0, all are 0 while ``photons`` is given, or the dead time is shorter
            than a bin.
        """
        light, dark = self._rates(capture)
        if self.pulses is not None:
            both = light + dark
            counts = np.zeros_like(both)
            ready = _Ready(self.pulses, self.dead_time, capture)
            for k, mean in enumerate(both):
                counts[k] = ready.expected(counts, k) * -np.expm1(-mean / self.pulses)
            kept = np.divide(counts, both, out=np.zeros_like(counts), where=counts > 0)
            light, dark = light * kept, dark * kept
        return np.asarray(self._stamped(light, capture.delta_t) + dark)

    def _rates(self, capture: TransientCapture) -> tuple[Array, Array]:
        """Return the mean numbers of photons and of dark counts that a ready detector counts."""
        H = capture.H
        lowest = float(H.min())
        if lowest < 0.0:
            raise SceneError(
                f"the capture has a bin of {lowest:g}, must be at least 0 to be an expected count; "
                "remove negative values"
            )
        arrays = 3 if self.pulses is None else 8
        fits_memory("detector", arrays * 8.0 * H.size, "split the capture")
        share = self.efficiency
        if self.photons is not None:
            total = float(H.sum(dtype=np.float64))
            if not total > 0.0:
                raise SceneError(
                    f"the capture has no light, detector.photons = {self.photons:g} cannot be "
                    "reached; omit photons or check the capture"
                )
            share *= self.photons / total
        open_share = self._open_share(capture).reshape(-1, *[1] * (H.ndim - 1))
        return H * (share * open_share), np.broadcast_to(self.dark_counts * open_share, H.shape)

    def measure(self, capture: TransientCapture, seed: int = 0) -> TransientCapture:
        """Draw the photon counts of one measurement.

        Parameters
        ----------
        capture : TransientCapture
            Capture to measure, with values of at least 0.
        seed : int
            Seed of the random numbers, 0 to 2^64 - 1. Results are identical for any number of
            threads.

        Returns
        -------
        TransientCapture
            Poisson counts, or with ``pulses`` those of as many independent pulses;
            ``quantity="counts"``. ``standard_error`` is the square root of the expected count of
            each bin; ``by_bounce`` is empty.

        Raises
        ------
        SceneError
            As `expected`, or if an expected count exceeds 2^50.

        See Also
        --------
        Detector.expected : Mean counts without noise.
        """
        from . import _detector_kernels

        key = checked_seed(seed)
        means = self.expected(capture)
        most = float(means.max())
        if most > 2.0**50:  # rounding of doubles would lose whole counts
            raise SceneError(f"a bin expects {most:g} counts, limit 2^50; give fewer photons")
        values = {
            name: value for name, value in asdict(self).items() if value not in (None, math.inf)
        }
        if self.pulses is None:
            counts: Array = np.empty(means.size)
            _detector_kernels.poisson(means.ravel(), np.uint64(key), counts)
        else:
            counts = self._drawn(capture, self.pulses, key)
        return replace(
            capture,
            H=counts.reshape(means.shape),
            quantity="counts",
            by_bounce={},
            standard_error=np.sqrt(means),
            details={**capture.details, "detector": values, "detector_seed": key},
        )

    def _drawn(self, capture: TransientCapture, pulses: int, key: int) -> Array:
        """Return random counts of all pulses, shaped like ``capture.H``."""
        light, dark = (part.reshape(capture.n_bins, -1) for part in self._rates(capture))
        both = light + dark
        hits = np.zeros(both.shape, dtype=np.int64)
        ready = _Ready(pulses, self.dead_time, capture)
        draws = [np.random.Generator(np.random.Philox(key=[key, k])) for k in range(len(both))]
        for k, (mean, random) in enumerate(zip(both, draws, strict=True)):
            free, before = ready.pulses(hits, k)
            free = free - random.binomial(before, ready.part)
            hits[k] = random.binomial(free, -np.expm1(-mean / pulses))
        stamps = hits.astype(np.float64)
        if self.jitter or self.tail:
            share = np.divide(light, both, out=np.ones_like(light), where=both > 0)
            most = float(hits.sum(axis=1).max())
            fits_memory("a draw of time stamps", 64.0 * most, "give fewer photons or pulses")
            for k, random in enumerate(draws):
                seen = random.binomial(hits[k], share[k])
                stamps[k] -= seen
                point = np.repeat(np.arange(seen.size), seen)
                late = self.tail * random.exponential(size=point.size)
                late *= random.uniform(size=point.size) < self.tail_share
                late += self.jitter * random.standard_normal(point.size)
                bins = k + np.floor(random.uniform(size=point.size) + late / capture.delta_t)
                inside = (bins >= 0) & (bins < capture.n_bins)
                np.add.at(stamps, (bins[inside].astype(np.int64), point[inside]), 1.0)
        return stamps.reshape(capture.H.shape)

    def _open_share(self, capture: TransientCapture) -> Array:
        """Return the fraction of each bin during which the gate is open, (n_bins,)."""
        if self.gate is None:
            return np.ones(capture.n_bins)
        inside = np.clip(capture.edges, *self.gate)
        return np.asarray(np.diff(inside) / capture.delta_t)

    def _stamped(self, means: Array, step: float) -> Array:
        """Return counts by recorded time: ``means`` convolved with the response along axis 0."""
        if not (self.jitter or self.tail):
            return means
        from scipy.ndimage import convolve1d
        from scipy.signal import lfilter

        n_bins = means.shape[0]
        response, before, rest = self._response(step, n_bins)
        origin = before - len(response) // 2
        stamped = np.asarray(convolve1d(means, response, axis=0, mode="constant", origin=origin))
        first = len(response) - before
        if rest and first < n_bins:
            # a recursive filter applies the exponential tail at a cost independent of its length
            decay = math.exp(-step / self.tail)
            stamped[first:] += rest * lfilter([1.0], [1.0, -decay], means[: n_bins - first], axis=0)
        return stamped

    def _response(self, step: float, n_bins: int) -> tuple[Array, int, float]:
        """Return the fraction of a bin's counts that is recorded j bins later.

        Let F be the distribution function of the time-stamp error and G its integral. For arrivals
        uniform over a bin, the fraction is the second difference of G at j steps, divided by the
        step. G is split into max(x, 0), whose share is 1 at j = 0 and 0 elsewhere, and a
        remainder. The remainder is small far from 0, so that rounding does no harm there.
        """
        reach = SIGMAS * self.jitter
        bend = self.jitter**2 / self.tail if self.tail else 0.0
        before = min(math.ceil(reach / step) + 1, n_bins)
        # beyond the Gaussian's reach the tail is purely exponential; a short tail ends earlier
        after = min(math.ceil((reach + min(bend, TAILS * self.tail)) / step) + 2, n_bins)
        at = step * np.arange(-before - 1.0, after + 2.0)
        response = np.diff(self._surplus(at), 2) / step
        response[before] += 1.0
        rest = 0.0
        if self.tail and bend < TAILS * self.tail:
            level = 0.5 * bend / self.tail - step * after / self.tail
            rest = self.tail_share * self.tail / step * math.exp(level)
            rest *= math.expm1(-step / self.tail) ** 2
        # far from j = 0 only rounding errors are negative
        return np.maximum(response, 0.0), before, rest

    def _surplus(self, x: Array) -> Array:
        """Return the integral of the error's distribution function up to x, minus max(x, 0), m.

        For the Gaussian it is sigma phi(z) - |x| Phi(-|z|), z = x/sigma. The distribution function
        T of the tail solves T + tail T' = Phi, so its integral is the Gaussian's minus tail T.
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


def _checked_dead_time(name: str, value: Any) -> float:
    """Return a dead time, m, above 0; it may be infinite."""
    return math.inf if value == math.inf else positive(name, value, unit="m")


class _Ready:
    """Number of pulses that find a detector ready, after each bin's counts."""

    def __init__(self, pulses: int, dead_time: float, capture: TransientCapture) -> None:
        bins = dead_time / capture.delta_t
        if bins < 1.0:
            raise SceneError(
                f"dead_time = {dead_time:g} m is out of range, must be at least the width of a "
                f"bin, {capture.delta_t:g} m; give a longer dead time or narrower bins"
            )
        self.all = pulses
        # a count comes in the middle of its bin on average
        self.part, whole_bins = math.modf(min(bins - 0.5, capture.n_bins))
        self.blind = int(whole_bins)
        self.busy: Any = 0

    def pulses(self, counts: NDArray[Any], k: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the pulses without a count in the blind bins before bin ``k``, in order of k.

        The second array has the counts in the bin before them: of these, the fraction ``part`` is
        blind still.
        """
        if k > 0:
            self.busy = self.busy + counts[k - 1]
        before = np.zeros_like(counts[0])
        if k > self.blind:
            before = counts[k - 1 - self.blind]
            self.busy = self.busy - before
        return np.asarray(self.all - self.busy), before

    def expected(self, counts: Array, k: int) -> Array:
        """Return the mean number of pulses that find the detector ready in bin ``k``."""
        ready, before = self.pulses(counts, k)
        return ready - self.part * before


def without_pile_up(
    capture: TransientCapture, *, pulses: int, dead_time: float = math.inf
) -> TransientCapture:
    """Correct photon counts for pile-up: what a detector without dead time would have counted.

    Parameters
    ----------
    capture : TransientCapture
        Measured counts, all bins since the laser pulse included: earlier counts hide later ones.
    pulses : int
        Laser pulses per point.
    dead_time : float
        Time after a count during which there is no other, m of optical path, as in `Detector`. By
        default a pulse has one count at most.

    Returns
    -------
    TransientCapture
        Corrected counts, with their ``standard_error`` by photon noise.

    Raises
    ------
    SceneError
        If ``pulses`` or ``dead_time`` is out of range, or a bin is below 0.
    SamplingError
        If some bin has as many counts as there are pulses ready.

    See Also
    --------
    Detector : Model of pile-up.

    Notes
    -----
    In a bin with n counts of N ready pulses, the corrected count is ``-pulses log(1 - n/N)``
    (Coates, J. Phys. E 1 (1968) 878).

    Examples
    --------
    >>> from nlosoptics.transient import TransientCapture, without_pile_up
    >>> counts = TransientCapture(
    ...     H=[300.0, 300.0, 0.0, 100.0],
    ...     laser_points=(0.0, 0.0, 0.0),
    ...     sensor_points=(0.0, 0.0, 0.0),
    ...     delta_t=0.01,
    ... )
    >>> print(without_pile_up(counts, pulses=1000).H.round(0))
    [357. 560.   0. 288.]
    """
    expect("capture", capture, "TransientCapture")
    counts = capture.H.astype(np.float64)
    if counts.min() < 0.0:
        raise SceneError(
            f"the capture has a bin of {counts.min():g}, must be at least 0 to be a count; give "
            "counts before any background is subtracted"
        )
    dead_time = _checked_dead_time("dead_time", dead_time)
    ready = _Ready(whole("pulses", pulses, 1, 1 << 50), dead_time, capture)
    number = np.stack([ready.expected(counts, k) for k in range(capture.n_bins)])
    full = np.argwhere(counts >= number)
    if full.size:
        at = tuple(full[0])
        raise SamplingError(
            f"bin {at[0]} has {counts[at]:g} counts, but only {max(number[at], 0):g} of {pulses} "
            "pulses find the detector ready; check pulses and dead_time, or measure with less light"
        )
    return replace(
        capture,
        H=-pulses * np.log1p(-counts / number),
        by_bounce={},
        standard_error=pulses * np.sqrt(counts / (number * (number - counts))),
    )
