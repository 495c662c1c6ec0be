"""Point spreads by other means than the library's: sums over many nodes or samples, one large OTF.

Zernike polynomials, nodes and normalisations are written anew here, from their definitions.
"""

import math

import ducc0
import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy import fft

#: Pupil nodes and image points beyond which a reference is out of reach.
MOST_NODES, MOST_POINTS, MOST_SIDE = 4e6, 1e5, 6000
#: Pupil nodes beyond which single pixels are out of reach, and nodes a block of rings.
MOST_FAR_NODES, BLOCK = 1e7, 1e6
#: Side of the lattice of separations.
MOST_LATTICE = 2400
#: Samples of the smooth wave's departure a side.
WINDOW = 1280


class OutOfReachError(Exception):
    """The reference would take too long."""


def zernike(index, rho, theta):
    """Noll's polynomials, rms 1 over the disc (Noll 1976)."""
    along, around = zernike_parts(index, rho, theta)
    return along * around


def zernike_parts(index, rho, theta):
    """Their factors, of the radius and of the angle."""
    n = 0
    while (n + 1) * (n + 2) // 2 < index:
        n += 1
    place = index - n * (n + 1) // 2  # from 1
    m = 2 * (place // 2) if n % 2 == 0 else 2 * ((place + 1) // 2) - 1
    radial = sum(
        (-1) ** k
        * math.factorial(n - k)
        / (math.factorial(k) * math.factorial((n + m) // 2 - k) * math.factorial((n - m) // 2 - k))
        * rho ** (n - 2 * k)
        for k in range((n - m) // 2 + 1)
    )
    if m == 0:
        return math.sqrt(n + 1) * radial, np.ones(np.shape(theta))
    turn = np.cos(m * theta) if index % 2 == 0 else np.sin(m * theta)
    return math.sqrt(2 * (n + 1)) * radial, turn


class Ellipse:
    """Outline with half axes 1 and b in units of a, the first at an angle, and a similar hole."""

    def __init__(self, b, angle, inner):
        self.b, self.angle, self.inner = b, angle, inner

    def nodes(self, v, more):
        """u/a, v/a and areas over a^2."""
        x, y, w = disc_nodes(v, more, self.inner)
        return *self._turned(x, y), w * self.b

    def blocks(self, v, more):
        """The same a block at a time."""
        for r, angle, area in disc_blocks(v, more, self.inner):
            x, y = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
            yield *self._turned(x, y), area[:, None] * self.b

    def _turned(self, x, y):
        y, c, s = y * self.b, math.cos(self.angle), math.sin(self.angle)
        return c * x - s * y, s * x + c * y


class Triangles:
    """Outline of triangles (n, 3, 2) in units of a."""

    def __init__(self, corners):
        self.corners = np.asarray(corners, dtype=float)

    def blocks(self, v, more):
        """u/a, v/a and areas over a^2, squares collapsed to triangles, one after another."""
        first, second, third = np.moveaxis(self.corners, 1, 0)
        edges = second - first, third - first
        longest = max(float(np.hypot(*e.T).max()) for e in edges)
        n = math.ceil(more * (0.4 * v * longest + 30))
        if n * n * len(first) > MOST_FAR_NODES:
            raise OutOfReachError(f"{len(first)} x {n} x {n} nodes")
        t, w = leggauss(n) if n < 1500 else _gauss(n)
        s, w = (t + 1) / 2, w / 2
        along, across = s[:, None], s[:, None] * s
        for corner, one, other in zip(first, *edges, strict=True):
            x, y = (corner[i] + along * one[i] + across * (other - one)[i] for i in (0, 1))
            area = abs(one[0] * other[1] - one[1] * other[0])
            yield x, y, area * (w * s)[:, None] * w

    def nodes(self, v, more):
        """The same at once."""
        parts = list(self.blocks(v, more))
        if sum(p[0].size for p in parts) > MOST_NODES:
            raise OutOfReachError(f"{len(parts)} x {parts[0][0].size} nodes")
        return tuple(np.concatenate([p[i].ravel() for p in parts]) for i in range(3))


def fan(corners, centre=(0.0, 0.0)):
    """Triangles of a polygon that its centre sees whole."""
    corners = np.asarray(corners)
    after = np.roll(corners, -1, axis=0)
    return [(centre, a, b) for a, b in zip(corners, after, strict=True)]


def disc_counts(v, more):
    """Radii and angles for phases that turn by v rad across the radius."""
    return math.ceil(more * (0.4 * v + 40)), math.ceil(more * (1.05 * v + 120))


def disc_radii(n_r, inner):
    """Gauss-Legendre radii and areas of an annulus."""
    t, w = leggauss(n_r) if n_r < 1500 else _gauss(n_r)
    r = inner + (1 - inner) * (t + 1) / 2
    return r, w * (1 - inner) / 2 * r * 2 * math.pi


def disc_nodes(v, more, inner):
    """u/a, v/a and areas over a^2, Gauss-Legendre in the radius and equal angles."""
    n_r, n_t = disc_counts(v, more)
    if n_r * n_t > MOST_NODES:
        raise OutOfReachError(f"{n_r} x {n_t} nodes")
    r, w = disc_radii(n_r, inner)
    angle = 2 * math.pi * (np.arange(n_t) + 0.5) / n_t
    x, y = (r[:, None] * np.cos(angle)).ravel(), (r[:, None] * np.sin(angle)).ravel()
    return x, y, np.repeat(w / n_t, n_t)


def disc_blocks(v, more, inner):
    """Radii, angles and areas of a few rings at a time."""
    n_r, n_t = disc_counts(v, more)
    if n_r * n_t > MOST_FAR_NODES:
        raise OutOfReachError(f"{n_r} x {n_t} nodes")
    radii, areas = disc_radii(n_r, inner)
    angle = 2 * math.pi * (np.arange(n_t) + 0.5) / n_t
    rings = max(1, int(BLOCK / n_t))
    for start in range(0, n_r, rings):
        some = slice(start, start + rings)
        yield radii[some], angle, areas[some] / n_t


class Wave:
    """A continuous wave: coefficients in waves, amplitude as a function of u/a and v/a.

    Its pupil is a disc, an annulus, or of an outline, `Ellipse` or `Triangles`.
    """

    def __init__(
        self, coefficients, amplitude, wavelength, radius, distance, obscuration, outline=None
    ):
        self.coefficients, self.amplitude = coefficients, amplitude
        self.wavelength, self.radius, self.distance = wavelength, radius, distance
        self.obscuration, self.outline = obscuration, outline

    def waves(self, x, y):
        """Aberration in waves at u/a, v/a."""
        rho, theta = np.hypot(x, y), np.arctan2(y, x)
        total = np.zeros(np.broadcast(x, y).shape)
        for index, height in self.coefficients.items():
            total += height * zernike(index, rho, theta)
        return total

    def steepest(self):
        """Largest slope of the phase across the radius, rad."""
        r = np.linspace(max(self.obscuration, 0.01), 1, 60)[:, None]
        t = np.linspace(0, 2 * math.pi, 180)
        x, y, h = r * np.cos(t), r * np.sin(t), 1e-5
        return (
            2
            * math.pi
            * float(
                np.hypot(
                    (self.waves(x + h, y) - self.waves(x - h, y)) / (2 * h),
                    (self.waves(x, y + h) - self.waves(x, y - h)) / (2 * h),
                ).max()
            )
        )

    def on_rings(self, r, angle):
        """The same at radii times angles (n_r, n_t)."""
        total = np.zeros((r.size, angle.size))
        for index, height in self.coefficients.items():
            along, around = zernike_parts(index, r, angle)
            total += np.multiply.outer(height * along * np.ones(r.size), around)
        return total

    def blocks(self, v, more):
        """Nodes' u/a, v/a, areas over a^2 and waves, a block of them at a time."""
        if self.outline is not None:
            yield from ((*part, self.waves(*part[:2])) for part in self.outline.blocks(v, more))
            return
        for r, angle, area in disc_blocks(v, more, self.obscuration):
            across = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
            yield *across, area[:, None], self.on_rings(r, angle)

    def nodes(self, v, more):
        """u/a, v/a and areas over a^2."""
        if self.outline is not None:
            return self.outline.nodes(v, more)
        return disc_nodes(v, more, self.obscuration)


def _gauss(n):
    theta = ducc0.misc.GL_thetas(n)
    return -np.cos(theta), ducc0.misc.GL_weights(n, 1) / (2 * math.pi)


def field(wave, x, y, more=1.0):
    """Sum of A w exp(ikW) exp(-2 pi i x.p/(lambda d)) over a^2 at any points, m; A's integrals."""
    turns = wave.radius / (wave.wavelength * wave.distance)
    far = float(np.hypot(x, y).max()) * abs(turns)
    u, v, w = wave.nodes(2 * math.pi * far + wave.steepest(), more)
    size = w * wave.amplitude(u, v)
    points = size * np.exp(2j * math.pi * wave.waves(u, v))
    targets = 2 * math.pi * turns * np.stack([x, y], axis=1)
    # an even spread of rounding: the transform's grid holds the product of both extents
    if 4 * far > MOST_SIDE:
        raise OutOfReachError(f"{4 * far:.3g} samples across")
    out = ducc0.nufft.experimental.nu2nu(
        points_in=points,
        coord_in=np.stack([u, v], axis=1),
        coord_out=targets,
        forward=True,
        epsilon=3e-13,
        nthreads=1,
    )
    return out, float(size.sum()), float((size * wave.amplitude(u, v)).sum())


def scale_of(wave, normalisation, pitch, total, energy):
    """What |field|^2 is multiplied by."""
    if normalisation == "ideal-peak":
        return 1 / total**2
    share = (wave.radius * pitch / (wave.wavelength * wave.distance)) ** 2
    return share / (energy if normalisation == "unit-sum" else math.pi)


def pixel_points(wave, pitch, integrated):
    """Offsets and weights along one side of a pixel."""
    if not integrated:
        return np.zeros(1), np.ones(1)
    unit = wave.wavelength * abs(wave.distance) / (2 * wave.radius)
    # the intensity turns by 2 pi over lambda N
    n = math.ceil(0.6 * math.pi * pitch / unit + 12)
    t, w = leggauss(n)
    return t * pitch / 2, w / 2


def continuous(wave, spread, rows, columns):
    """Values of the pixels (rows, columns) of a library's point spread, and the doubt."""
    step, weight = pixel_points(wave, spread.pitch, spread.pixel_integrated)
    x = spread.x[columns][:, None, None] + step
    y = spread.y[rows][:, None, None] + step[:, None]
    x, y = (a.ravel() for a in np.broadcast_arrays(x, y))
    found = []
    for more in (1.0, 1.1):
        image, total, energy = field(wave, x, y, more)
        image = np.abs(image.reshape(len(rows), len(step), len(step))) ** 2
        scale = scale_of(wave, spread.normalisation, spread.pitch, total, energy)
        found.append(np.einsum("pij,i,j->p", image, weight, weight) * scale)
    return found[1], float(np.abs(found[1] - found[0]).max())


def single(wave, spread, rows, columns):
    """The same of a few pixels of a wave of any steepness, each by a sum of its own.

    Nodes come in blocks of rings, and each pixel's points are turned to its centre, so that
    the transform's grid spans one pixel alone. The doubt is the first pixel's.
    """
    step, weight = pixel_points(wave, spread.pitch, spread.pixel_integrated)
    x0, y0 = spread.x[columns], spread.y[rows]
    fine = _pixel_fields(wave, x0, y0, step, 1.0)
    again = _pixel_fields(wave, x0[:1], y0[:1], step, 1.1)
    values = []
    for image, total, energy in (fine, again):
        scale = scale_of(wave, spread.normalisation, spread.pitch, total, energy)
        values.append(np.einsum("pij,i,j->p", np.abs(image) ** 2, weight, weight) * scale)
    return values[0], abs(float(values[1][0] - values[0][0]))


def _pixel_fields(wave, x0, y0, step, more):
    """Field at the points of each pixel, (pixels, n, n), and the amplitude's integrals."""
    turns = wave.radius / (wave.wavelength * wave.distance)
    far = float(np.hypot(np.abs(x0) + step[-1], np.abs(y0) + step[-1]).max()) * abs(turns)
    y, x = (a.ravel() for a in np.meshgrid(step, step, indexing="ij"))
    targets = 2 * math.pi * turns * np.stack([x, y], axis=1)
    found = np.zeros((len(x0), x.size), complex)
    total = energy = 0.0
    for u, v, area, phase in wave.blocks(2 * math.pi * far + wave.steepest(), more):
        amplitude = wave.amplitude(u, v)
        size = area * amplitude
        total, energy = total + float(size.sum()), energy + float((size * amplitude).sum())
        coord = np.stack([u.ravel(), v.ravel()], axis=1)
        for image, cx, cy in zip(found, x0, y0, strict=True):
            turned = phase - turns * (cx * u + cy * v)
            image += ducc0.nufft.experimental.nu2nu(
                points_in=(size * np.exp(2j * math.pi * turned)).ravel(),
                coord_in=coord,
                coord_out=targets,
                forward=True,
                epsilon=1e-11,
                nthreads=1,
            )
    return found.reshape(len(x0), step.size, step.size), total, energy


def sampled(front, wave, spread):
    """Direct sum of a map's samples for every pixel."""
    step, weight = pixel_points(wave, spread.pitch, spread.pixel_integrated)
    turns = 2 * math.pi / (wave.wavelength * wave.distance)
    ny, nx = spread.shape
    if max(ny, nx) * len(step) > MOST_SIDE:
        raise OutOfReachError(f"{max(ny, nx) * len(step)} points across")
    axis = front.u[0]
    along = np.exp(-1j * turns * np.outer((spread.x[:, None] + step).ravel(), axis))
    across = np.exp(-1j * turns * np.outer((spread.y[:, None] + step).ravel(), axis))
    size = front.amplitude * front.pupil_pitch**2
    pupil = size * np.exp(2j * math.pi * front.aberration / wave.wavelength)
    total = float(size.sum()) / wave.radius**2
    energy = float((size * front.amplitude).sum()) / wave.radius**2
    image = np.abs(across @ pupil @ along.T) ** 2 / wave.radius**4
    image = np.einsum("ipjq,p,q->ij", image.reshape(ny, len(step), nx, len(step)), weight, weight)
    return image * scale_of(wave, spread.normalisation, spread.pitch, total, energy)


def clear_otf(d, inner):
    """Overlap of two annuli of outer radius 1 and inner radius ``inner``, over the area of one."""

    def overlap(a, b):
        """Of discs a >= b: Weisstein's circle-circle intersection."""
        mid = (d > a - b) & (d < a + b)
        x = np.where(mid, d, a)
        first = np.arccos(np.clip((x**2 + a**2 - b**2) / (2 * x * a), -1, 1))
        second = np.arccos(np.clip((x**2 + b**2 - a**2) / (2 * x * max(b, 1e-300)), -1, 1))
        root = (-x + a + b) * (x + a - b) * (x - a + b) * (x + a + b)
        lens = a**2 * first + b**2 * second - np.sqrt(np.maximum(root, 0)) / 2
        return np.where(mid, lens, np.where(d <= a - b, math.pi * b**2, 0.0))

    if inner == 0:
        return overlap(1.0, 1.0) / math.pi
    both = overlap(1.0, 1.0) - 2 * overlap(1.0, inner) + overlap(inner, inner)
    return both / (math.pi * (1 - inner**2))


def rough(wave, spread, s, correlation, footprint, halo):
    """Mean of rough walls, energy per pixel of a plane of 1, and the doubt.

    From two large grids of separations, whose periods differ. The smooth wave's departure from the
    clear pupil's closed form is transformed from a window of its point spread: the tails of both
    are the same.
    """
    unit = wave.wavelength * abs(wave.distance) / (2 * wave.radius)
    m = math.ceil(spread.pitch / (0.45 * unit))
    m += 1 - m % 2  # pixel centres on the lattice
    fine = spread.pitch / m
    half = max(spread.shape) * spread.pitch / 2 + wave.steepest() / math.pi * unit
    n = math.ceil(max(2 * (half + 4 * halo), 1800 * unit) / fine)
    if 2 * half / fine > 0.6 * MOST_LATTICE:
        raise OutOfReachError(f"{n} samples across")
    departure = None
    if any(wave.coefficients.values()):
        departure = _departure(wave, WINDOW, fine)
    images = []
    for share in (0.75, 1.0):
        size = 2 * int(ducc0.fft.good_size(math.ceil(share * min(n, MOST_LATTICE) / 2)))
        part = departure
        if departure is not None and share < 1:  # what its own window cuts off, too
            part = departure[WINDOW // 8 : -WINDOW // 8, WINDOW // 8 : -WINDOW // 8]
        images.append(_on_lattice(wave, spread, size, m, part, s, correlation, footprint))
    return images[1], float(np.abs(images[1] - images[0]).max())


def _on_lattice(wave, spread, n, m, departure, s, correlation, footprint):
    fine = spread.pitch / m
    # an image is real: half the separations do; cycles per m of image
    fx, fy = np.fft.rfftfreq(n, fine), np.fft.fftfreq(n, fine)[:, None]
    du, dv = (f * wave.wavelength * abs(wave.distance) for f in (fx, fy))
    d = np.hypot(dv, du) / wave.radius
    lit = d < 2
    otf = np.zeros(d.shape, complex)
    otf[lit] = clear_otf(d[lit], wave.obscuration)
    if departure is not None:
        size = len(departure)
        padded = np.zeros((n, n))
        padded[:size, :size] = departure
        otf += fft.rfft2(np.roll(padded, (-(size // 2),) * 2, axis=(0, 1)))
        otf[~lit] = 0
    if s:
        lag = np.hypot(footprint[0] * du, footprint[1] * dv)[lit]
        otf[lit] *= np.exp(-(s**2) * (1 - correlation(lag)))
    if spread.pixel_integrated:
        otf *= np.sinc(fx * spread.pitch) * np.sinc(fy * spread.pitch)
    image = fft.irfft2(otf, (n, n)) * m**2
    rows, columns = (m * (np.arange(k) - k // 2) % n for k in spread.shape)
    return image[np.ix_(rows, columns)]


def _departure(wave, size, fine):
    """Smooth spread less the clear one, energy per sample."""
    turns = wave.radius / (wave.wavelength * wave.distance)
    axis = (np.arange(size) - size // 2) * fine
    u, v, w = wave.nodes(2 * math.pi * abs(turns) * abs(axis[0]) * 1.5 + wave.steepest(), 1.0)
    images = []
    for points in (w * np.exp(2j * math.pi * wave.waves(u, v)), w + 0j):
        out = ducc0.nufft.nu2u(
            points=points,
            coord=2 * math.pi * turns * fine * np.stack([v, u], axis=1),
            forward=True,
            epsilon=1e-12,
            nthreads=1,
            out=np.empty((size, size), complex),
        )
        images.append(np.abs(out) ** 2)
    energy = math.pi * (1 - wave.obscuration**2)
    return (images[0] - images[1]) * (turns * fine) ** 2 / energy
