// The page "Move it yourself": what a camera sees of a letter by way of a wall, and what can be
// recovered, computed anew while one moves things. Lengths in metres; the wall is at z = 0, the
// letter at z = 1. tests/site/test_live.py compares the numbers with those of the library.
"use strict";
const LIVE = (() => {
  const PIXELS = 32, CELLS = 16, SIDE = 0.6, VIEW = 0.8, FINE = 64;
  const F = (row, column, n) => {
    const [y, x] = [row / n, column / n];
    return +((x >= 0.25 && x < 0.4 && y >= 0.125 && y < 0.875) ||
      (x >= 0.25 && x < 0.75 && ((y >= 0.125 && y < 0.27) || (x < 0.65 && y >= 0.44 && y < 0.58))));
  };
  const letter = (n) => Float64Array.from({ length: n * n }, (_, k) => F(Math.floor(k / n) + 0.5, (k % n) + 0.5, n));

  // Part of a unit square, centred on the origin, with normal . x > distance.
  function beyond(distance, nx, ny) {
    const [a, b] = [Math.abs(nx), Math.abs(ny)].sort((p, q) => q - p);
    const [far, near] = [(a + b) / 2, (a - b) / 2];
    const d = Math.abs(distance);
    let part = 0;
    if (d < near) part = 0.5 - d / a;
    else if (d < far) part = (far - d) ** 2 / (2 * a * b);
    return distance > 0 ? part : 1 - part;
  }

  // Light A in each pixel of the wall, row after row from the top, for each cell of a bright square,
  // and the image of the letter on twice as many cells: a photograph knows nothing of our cells.
  // Pixels and cells are cut into 2 x 2 parts, of which the parts of cells are clipped by the disc.
  function operator(disc, pixels = PIXELS, cells = CELLS) {
    const A = new Float64Array(pixels ** 2 * cells ** 2), size = SIDE / (2 * cells);
    const image = new Float64Array(pixels ** 2), picture = letter(2 * cells);
    const at = (k, n, side) => ((k + 0.5) / n - 0.5) * side;
    for (let row = 0; row < 2 * pixels; row++)
      for (let column = 0; column < 2 * pixels; column++) {
        const wx = at(column, 2 * pixels, VIEW), wy = -at(row, 2 * pixels, VIEW);
        const pixel = (row >> 1) * pixels + (column >> 1);
        for (let j = 0; j < 2 * cells; j++)
          for (let k = 0; k < 2 * cells; k++) {
            const x = at(k, 2 * cells, SIDE), y = -at(j, 2 * cells, SIDE);
            const light = (size / 2 / (1 + (wx - x) ** 2 + (wy - y) ** 2)) ** 2;
            // where the line from wall to cell passes the disc's height, from the disc's centre
            const px = wx * (1 - disc.z) + x * disc.z - disc.x, py = wy * (1 - disc.z) + y * disc.z - disc.y;
            const r = Math.hypot(px, py) || 1e-12, shadow = size * disc.z;
            // the rim is straight here, less its mean sagitta over the part of a cell
            const chord = shadow / Math.max(Math.abs(px), Math.abs(py)) * r;
            const distance = (disc.radius - r - chord ** 2 / (24 * disc.radius)) / shadow;
            const part = Math.abs(distance) > 0.71 ? +(distance < 0) : beyond(distance, px / r, py / r);
            A[pixel * cells ** 2 + (j >> 1) * cells + (k >> 1)] += light * part;
            image[pixel] += light * part * picture[j * 2 * cells + k];
          }
      }
    return { A, image };
  }

  // Tikhonov's answer (A'A + weight) x = A'y, by Cholesky's factors.
  function solve(A, y, weight) {
    const n = A.length / y.length, G = Array.from({ length: n }, () => new Float64Array(n)), x = new Float64Array(n);
    for (let i = 0; i < y.length; i++)
      for (let j = 0; j < n; j++) {
        const value = A[i * n + j];
        x[j] += value * y[i];
        for (let k = 0; k <= j; k++) G[j][k] += value * A[i * n + k];
      }
    for (let j = 0; j < n; j++) {
      G[j][j] += weight;
      for (let k = 0; k <= j; k++) {
        let sum = G[j][k];
        for (let m = 0; m < k; m++) sum -= G[j][m] * G[k][m];
        G[j][k] = j === k ? Math.sqrt(sum) : sum / G[k][k];
      }
    }
    for (let j = 0; j < n; j++) {
      for (let m = 0; m < j; m++) x[j] -= G[j][m] * x[m];
      x[j] /= G[j][j];
    }
    for (let j = n - 1; j >= 0; j--) {
      for (let m = j + 1; m < n; m++) x[j] -= G[m][j] * x[m];
      x[j] /= G[j][j];
    }
    return x;
  }

  // Normal deviates, the same at each call: the noise of one photograph.
  function noise(n) {
    let state = 1;
    const uniform = () => ((state = (Math.imul(state, 1664525) + 1013904223) >>> 0) + 0.5) / 2 ** 32;
    return Float64Array.from({ length: n }, () => Math.sqrt(-2 * Math.log(uniform())) * Math.cos(2 * Math.PI * uniform()));
  }
  const DEVIATES = noise(FINE ** 2);

  // Modulation that facets pass of a pattern at 1 m by way of the wall, with frequencies in 1/m:
  // their slopes of rms s spread the light by 2 s.
  const modulation = (slope, frequency) => Math.exp(-2 * (Math.PI * 2 * slope * frequency) ** 2);

  // A picture with its cosine waves multiplied by a factor of (modulation).
  function filtered(picture, n, slope, factor) {
    const wave = (k, i) => Math.sqrt((k ? 2 : 1) / n) * Math.cos((Math.PI * k * (i + 0.5)) / n);
    const C = Float64Array.from({ length: n * n }, (_, k) => wave(Math.floor(k / n), k % n));
    const along = (rows, forward) => {
      const out = new Float64Array(n * n); // transposed, so that two passes do both axes
      for (let r = 0; r < n; r++)
        for (let k = 0; k < n; k++)
          for (let i = 0; i < n; i++) out[k * n + r] += (forward ? C[k * n + i] : C[i * n + k]) * rows[r * n + i];
      return out;
    };
    const waves = along(along(picture, true), true);
    for (let k = 0; k < n * n; k++) {
      const frequency = Math.hypot(Math.floor(k / n), k % n) / (2 * SIDE);
      waves[k] *= factor(modulation(slope, frequency));
    }
    return along(along(waves, false), false);
  }

  // Photograph and answer past a disc, by counts of photons in the mean pixel.
  function matt(disc, photons) {
    const { A, image: clean } = operator(disc);
    const scale = (photons * clean.length) / clean.reduce((sum, value) => sum + value, 0);
    const photograph = clean.map((value, i) => scale * value + Math.sqrt(scale * value) * DEVIATES[i]);
    const weight = photons / scale ** 2 / 0.1; // the noise's variance over the letter's
    return { photograph, answer: solve(A, photograph.map((value) => value / scale), weight) };
  }

  // Photograph and answer by way of facets; Wiener's filter.
  function glossy(slope, photons) {
    const clean = filtered(letter(FINE), FINE, slope, (m) => m);
    const photograph = clean.map((value, i) => photons * value + Math.sqrt(photons * (Math.abs(value) + 0.05)) * DEVIATES[i]);
    const weight = 3 / photons; // the noise's variance over that of the letter's waves, about 0.1
    return { photograph, answer: filtered(photograph.map((v) => v / photons), FINE, slope, (m) => m / (m * m + weight)) };
  }

  function correlation(a, b) {
    const mean = (v) => v.reduce((sum, x) => sum + x, 0) / v.length;
    const [p, q] = [mean(a), mean(b)];
    let ab = 0, aa = 0, bb = 0;
    for (let i = 0; i < a.length; i++) {
      ab += (a[i] - p) * (b[i] - q);
      aa += (a[i] - p) ** 2;
      bb += (b[i] - q) ** 2;
    }
    return ab / Math.sqrt(aa * bb);
  }

  return { operator, solve, letter, matt, glossy, modulation, correlation, PIXELS, CELLS, FINE };
})();

document.addEventListener("DOMContentLoaded", () => {
  const page = document.getElementById("live");
  if (!page) return;
  const part = (name) => page.querySelector(`[name=${name}]`);
  function draw(name, values, bound) {
    const n = Math.sqrt(values.length), canvas = part(name), context = canvas.getContext("2d");
    const [low, high] = bound ?? [Math.min(...values), Math.max(...values)];
    canvas.width = canvas.height = n;
    const image = context.createImageData(n, n);
    values.forEach((value, k) => {
      image.data.fill(Math.max(0, Math.min(255, (255 * (value - low)) / (high - low))), 4 * k, 4 * k + 3);
      image.data[4 * k + 3] = 255;
    });
    context.putImageData(image, 0, 0);
  }
  const value = (name) => Number(part(name).value);
  const say = (name, answer, truth) => {
    part(name).value = `correlation with the letter ${LIVE.correlation(answer, truth).toFixed(2)}`;
  };
  const disc = { x: 0, y: 0 }, space = part("space"), turn = { across: -50, up: -15 };
  function show() {
    Object.assign(disc, { z: value("height") / 100, radius: value("radius") / 100 });
    const photons = 10 ** value("photons");
    const matt = LIVE.matt(disc, photons), glossy = LIVE.glossy(value("slope") / 1000, photons);
    draw("matt", matt.photograph);
    draw("wall", matt.photograph);
    draw("shadows", matt.answer, [0, 1]);
    draw("glossy", glossy.photograph);
    draw("sharpened", glossy.answer, [0, 1]);
    say("shadows-says", matt.answer, LIVE.letter(LIVE.CELLS));
    say("sharpened-says", glossy.answer, LIVE.letter(LIVE.FINE));
    for (const [name, text] of [["height", " cm from the wall"], ["radius", " cm"], ["slope", " mrad rms"]])
      part(`${name}-says`).value = part(name).value + text;
    part("photons-says").value = `${Number(photons.toPrecision(1)).toLocaleString("en")} photons in a pixel`;
    const circle = part("disc");
    circle.setAttribute("cx", 100 + 200 * disc.x);
    circle.setAttribute("cy", 100 - 200 * disc.y);
    circle.setAttribute("r", 200 * disc.radius);
    for (const [name, number] of Object.entries(disc)) space.style.setProperty(`--${name}`, number);
  }
  page.querySelectorAll("input").forEach((input) => input.addEventListener("input", show));
  // The room in 3-D is turned by its style sheet.
  const turned = (across, up) => {
    turn.across = Math.max(-85, Math.min(85, turn.across + across));
    turn.up = Math.max(-85, Math.min(85, turn.up + up));
    space.style.setProperty("--across", `${turn.across}deg`);
    space.style.setProperty("--up", `${turn.up}deg`);
  };
  space.addEventListener("pointerdown", (event) => space.setPointerCapture(event.pointerId));
  space.addEventListener("pointermove", (event) => {
    if (space.hasPointerCapture(event.pointerId)) turned(event.movementX / 2, -event.movementY / 2);
  });
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const onArrows = (element, act) => element.addEventListener("keydown", (event) => {
    if (!arrows[event.key]) return;
    event.preventDefault();
    act(...arrows[event.key]);
  });
  onArrows(space, (x, y) => turned(5 * x, 5 * y));
  turned(0, 0);
  const board = part("board");
  const move = (event) => {
    const box = board.getBoundingClientRect();
    disc.x = (event.clientX - box.left) / box.width - 0.5;
    disc.y = 0.5 - (event.clientY - box.top) / box.height;
    show();
  };
  board.addEventListener("pointerdown", (event) => {
    board.setPointerCapture(event.pointerId);
    move(event);
    board.addEventListener("pointermove", move);
  });
  board.addEventListener("pointerup", () => board.removeEventListener("pointermove", move));
  onArrows(board, (x, y) => {
    disc.x += 0.02 * x;
    disc.y += 0.02 * y;
    show();
  });
  show();
});
