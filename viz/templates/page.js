"use strict";
// Folded parts open for a link that points into them, and for the printer.
function unfold() {
  const part = location.hash.length > 1 && document.getElementById(location.hash.slice(1));
  const folded = part && part.querySelector("details");
  if (folded) { folded.open = true; part.scrollIntoView(); }
}
addEventListener("hashchange", unfold);
unfold();
addEventListener("beforeprint", () => {
  for (const one of document.querySelectorAll("section > details")) one.open = true;
});

// Tables that a click on a heading sorts: by number where cells have one, else by their words.
for (const table of document.querySelectorAll("table.sorted:not(.long)")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  const key = (row, k) => {
    const cell = row.cells[k];
    return cell.dataset.value === undefined ? cell.textContent.trim() : Number(cell.dataset.value);
  };
  heads.forEach((head, k) => head.querySelector("button").addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const rows = [...body.rows].sort((a, b) => {
      const x = key(a, k), y = key(b, k);
      if (typeof x !== typeof y) return typeof x === "number" ? -1 : 1;  // no number: last
      const order = typeof x === "number" ? x - y : x.localeCompare(y);
      return down ? -order : order;
    });
    body.append(...rows);
  }));
}

// A number tells more of its digits to a pointer.
addEventListener("pointerover", (event) => {
  const cell = event.target.closest?.("td[data-value]");
  if (cell) cell.title = String(Number(Number(cell.dataset.value).toPrecision(6)));
});

// Rows that hold every word that was typed.
const filter = document.getElementById("filter");
if (filter) filter.addEventListener("input", () => {
  const words = filter.value.toLowerCase().split(/\s+/);
  for (const row of document.getElementById("cells").tBodies[0].rows) {
    const text = row.textContent.toLowerCase();
    row.hidden = !words.every((word) => text.includes(word));
  }
});

// A mark of the first figure tells of its cell.
const kept = document.getElementById("episodes-data");
if (kept) {
  const episodes = JSON.parse(kept.textContent), said = document.getElementById("picked");
  for (const dot of document.querySelectorAll(".dot")) {
    const tell = () => {
      const found = episodes[dot.dataset.cell + " " + dot.dataset.readout];
      said.textContent = dot.getAttribute("aria-label") + (found ? ". " + found : "");
    };
    dot.addEventListener("click", tell);
    dot.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); tell(); }
    });
  }
}

// The hues of bodies, told apart with every common kind of colour vision; 3 : 1 on light and dark.
const HUES = ["#c8641e", "#2f86c6", "#00876a", "#b4609a", "#8a7a10", "#7a7f87"];

// Bodies at one instant, their ways until then, and the truth as rings.
function drawBodies(canvas, extent, truth, guess, until) {
  const size = canvas.width, pen = canvas.getContext("2d");
  const style = getComputedStyle(document.documentElement);
  const at = ([x, y]) => [size / 2 * (1 + x / extent), size / 2 * (1 - y / extent)];
  pen.clearRect(0, 0, size, size);
  const way = (path, n, colour, width) => {
    pen.strokeStyle = colour; pen.lineWidth = width; pen.beginPath();
    for (let t = 0; t <= until && path[t]; t++) pen.lineTo(...at(path[t][n]));
    pen.stroke();
  };
  const bodies = truth[0].length, grey = style.getPropertyValue("--dim");
  for (let n = 0; n < bodies; n++) {
    way(truth, n, grey, 1);
    pen.beginPath(); pen.arc(...at(truth[Math.min(until, truth.length - 1)][n]), 8, 0, 7); pen.stroke();
  }
  for (let n = 0; n < bodies; n++) {
    if (!guess[0]) break;
    way(guess, n, HUES[n % HUES.length], 2);
    const place = guess[Math.min(until, guess.length - 1)][n];
    pen.fillStyle = HUES[n % HUES.length];
    pen.beginPath(); pen.arc(...at(place), 5, 0, 7); pen.fill();
  }
}

// One episode that a head answers, and its twin does not, as it moves.
const moves = document.getElementById("moving-data");
if (moves) {
  const told = JSON.parse(moves.textContent), play = document.getElementById("play");
  const canvases = [...document.querySelectorAll("#moving canvas")];
  const count = told.truth.length, still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  let now = told.start, running = !still, last = 0;
  const draw = () => canvases.forEach((canvas, k) =>
    drawBodies(canvas, told.extent, told.truth, told.sides[k].path, Math.floor(now)));
  const step = (time) => {
    if (!running) return;
    now = (now + Math.min(time - last, 100) / 1000 * count / 4) % (count + 12);
    last = time;
    draw();
    requestAnimationFrame(step);
  };
  const label = () => { play.textContent = running ? "Pause" : "Play"; };
  play.addEventListener("click", () => {
    running = !running; label();
    if (running) { last = performance.now(); requestAnimationFrame(step); }
  });
  label(); draw();
  // It moves while it is seen: nothing is drawn for nobody.
  new IntersectionObserver(([seen]) => {
    if (seen.isIntersecting && running) { last = performance.now(); requestAnimationFrame(step); }
  }).observe(document.getElementById("moving"));
}
