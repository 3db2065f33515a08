"use strict";
// The law under one's hand: sliders and dragged bodies, rolled anew at every change.
(() => {
  const law = JSON.parse(document.getElementById("play-data").textContent);
  const canvas = document.getElementById("law-canvas"), pen = canvas.getContext("2d");
  const said = document.getElementById("law-said");
  const learned = splineGradient(law), truth = trueGradient(law);
  const inputs = [...document.querySelectorAll("#law input")];
  const start = { q: [...law.q], p: [...law.p], mass: [...law.mass], dt: law.dt };
  const size = canvas.width, extent = law.extent;
  const at = (x, y) => [size / 2 * (1 + x / extent), size / 2 * (1 - y / extent)];
  const style = () => getComputedStyle(document.documentElement);
  let moved = false;

  const way = (path, n, colour, width, dash) => {
    pen.strokeStyle = colour; pen.lineWidth = width; pen.setLineDash(dash); pen.beginPath();
    for (const place of path) pen.lineTo(...at(place[2 * n], place[2 * n + 1]));
    pen.stroke(); pen.setLineDash([]);
  };
  // The twin is a large network: it was rolled beforehand, at these couplings from this start.
  const twinAt = (asked) => {
    if (!law.twin || moved || asked.friction > 0 || Math.abs(start.mass[0] - law.mass[0]) > 1e-3) return null;
    const gaps = law.twin.couplings.map((g) => Math.abs(g - asked.coupling));
    const near = gaps.indexOf(Math.min(...gaps));
    return gaps[near] < 0.051 ? law.twin.paths[near] : null;
  };
  const draw = () => {
    const began = performance.now();
    const [coupling, friction, mass] = inputs.map((input) => Number(input.value));
    start.mass[0] = mass;
    for (const input of inputs) input.nextElementSibling.textContent = Number(input.value).toFixed(2).replace("-", "\u2212");
    const asked = { coupling, friction, steps: law.steps, every: law.every };
    const mine = roll(learned, start, asked), real = roll(truth, start, asked), twin = twinAt(asked);
    pen.clearRect(0, 0, size, size);
    const grey = style().getPropertyValue("--dim");
    for (let n = 0; n < start.mass.length; n++) {
      way(real, n, grey, 5, []);
      if (twin) way(twin, n, HUES[n % HUES.length], 1.5, [4, 4]);
      way(mine, n, HUES[n % HUES.length], 2.5, []);
      pen.fillStyle = HUES[n % HUES.length];
      pen.beginPath(); pen.arc(...at(start.q[2 * n], start.q[2 * n + 1]), 5 + 4 * start.mass[n], 0, 7); pen.fill();
    }
    let worst = 0;
    mine[mine.length - 1].forEach((x, k) => { worst = Math.max(worst, Math.abs(x - real[real.length - 1][k])); });
    canvas.dataset.ms = (performance.now() - began).toFixed(1);
    said.textContent = `After ${(law.steps * law.dt).toFixed(1)} s the learned law is off by at most ${worst.toPrecision(2)} world units.`
      + (twin ? "" : " The twin was rolled only from this start, without friction.");
  };
  for (const input of inputs) input.addEventListener("input", draw);
  document.getElementById("law-reset").addEventListener("click", () => {
    start.q = [...law.q]; moved = false;
    inputs.forEach((input) => { input.value = input.defaultValue; });
    draw();
  });
  let held = -1;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(2 * (event.clientX - box.left) / box.width - 1) * extent,
      (1 - 2 * (event.clientY - box.top) / box.height) * extent];
  };
  canvas.addEventListener("pointerdown", (event) => {
    const [x, y] = place(event);
    const gaps = start.mass.map((_, n) => Math.hypot(start.q[2 * n] - x, start.q[2 * n + 1] - y));
    held = gaps.indexOf(Math.min(...gaps));
    if (gaps[held] > extent / 6) held = -1; else canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (held < 0) return;
    [start.q[2 * held], start.q[2 * held + 1]] = place(event);
    moved = true; draw();
  });
  canvas.addEventListener("pointerup", () => { held = -1; });
  draw();
})();
