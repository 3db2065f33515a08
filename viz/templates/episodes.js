"use strict";
// A table of many episodes: only the rows that are seen are there.
function episodeTable(root, filter, said, choose) {
  const COLUMNS = ["episode", "status", "error", "end", "closest", "drift", "coupling", "mass"];
  const SMALL_FIRST = ["episode", "closest"];  // what one looks for there is small
  const WORDS = { mean: "error", end: "end", closest: "closest", drift: "drift", g: "coupling", mass: "mass", episode: "episode" };
  const box = root.parentElement, body = root.tBodies[0], heads = [...root.tHead.rows[0].cells];
  const plain = (x) => Number.isFinite(x) ? Number(x.toPrecision(3)).toString().replace("-", "−") : x === Infinity ? "∞" : "–";
  let count = 0, data = {}, known = null, order = [], by = "episode", down = false, chosen = -1, tall = 30, status = null, masses = null;

  // What is not finite is further away than all that is; what is not rolled yet has no number.
  const value = (name, e) => name === "episode" ? e : name === "mass" || name === "coupling" ? data[name][e]
    : !known[e] ? NaN : name === "status" ? data.status[e] : data[name][e];
  function reset(told, words) {
    count = told.episodes; status = words; known = new Uint8Array(count); data = {};
    for (const name of COLUMNS) data[name] = new Float64Array(count).fill(NaN);
    masses = told.mass;
    for (let e = 0; e < count; e++) data.mass[e] = told.mass[e].reduce((a, b) => a + b, 0);
    own(told, null); chosen = -1; arrange();
  }
  // The coupling of each, its own or the one that was asked.
  function own(told, asked) {
    if (told.coupling) for (let e = 0; e < count; e++) data.coupling[e] = asked === null ? told.coupling[e] : asked;
  }
  function forget(told, asked) { known.fill(0); own(told, asked); arrange(); }
  function take(about) {
    const { rows } = about, first = about.episode;
    const many = rows.closest.length;
    for (let k = 0; k < many; k++) {
      const e = first + k;
      known[e] = 1;
      for (const name of ["error", "end", "closest", "drift"]) {
        const x = rows[name] ? rows[name][k] : NaN;
        data[name][e] = x === null ? Infinity : x;
      }
      data.status[e] = rows.bad[k] >= 0 ? 1e9 + rows.bad[k] : rows.left[k] >= 0 ? 1 + rows.left[k] : 0;
    }
    arrange();
  }
  const happened = (e) => {
    const x = data.status[e];
    return !known[e] ? "not rolled yet" : status(x >= 1e9 ? -1 : x - 1, x >= 1e9 ? x - 1e9 : -1);
  };
  // Every word: a part of the status, a number of an episode, or a bound such as `end>0.5`.
  function wanted() {
    const asked = filter.value.trim().replace(/\s*([<>])\s*/g, "$1").toLowerCase().split(/\s+/).filter((x) => x);
    return asked.map((word) => {
      const bound = word.match(/^([a-z]+)([<>])([-+\d.e]+)$/), name = bound && WORDS[bound[1]], edge = bound && Number(bound[3]);
      if (name) return (e) => bound[2] === "<" ? value(name, e) < edge : value(name, e) > edge;
      return (e) => String(e) === word || happened(e).includes(word);
    });
  }
  function arrange() {
    const tests = wanted(), keys = new Float64Array(count), kept = [];
    for (let e = 0; e < count; e++) {
      keys[e] = value(by, e);
      if (tests.every((test) => test(e))) kept.push(e);
    }
    const late = (x) => Number.isNaN(x);
    order = kept.sort((a, b) => late(keys[a]) || late(keys[b]) ? late(keys[a]) - late(keys[b]) || a - b
      : keys[a] === keys[b] ? a - b : (keys[a] < keys[b]) === down ? 1 : -1);
    let rolled = 0;
    for (const x of known) rolled += x;
    said.textContent = `${order.length.toLocaleString("en")} of ${count.toLocaleString("en")} episodes`
      + (rolled < count ? `; ${rolled.toLocaleString("en")} rolled so far` : "");
    draw();
  }
  function cellsOf(e) {
    const row = document.createElement("tr"), go = document.createElement("a");
    row.dataset.episode = e; row.className = e === chosen ? "chosen" : "";
    for (const name of COLUMNS) {
      const cell = row.insertCell(), x = value(name, e);
      if (name === "episode") { go.href = "#stage"; go.textContent = e; cell.append(go); }
      else cell.textContent = name === "status" ? happened(e) : name === "mass" ? masses[e].slice(0, 6).map(plain).join(", ") : plain(x);
      if (name !== "status") { cell.className = "num"; if (!Number.isNaN(x)) cell.dataset.value = x; }
    }
    return row;
  }
  const gap = (rows) => {
    const row = document.createElement("tr"), cell = row.insertCell();
    row.className = "gap"; cell.colSpan = COLUMNS.length; cell.style.height = rows * tall + "px";
    return row;
  };
  let drawn = "";
  function draw() {
    const first = Math.max(0, Math.min(order.length - 1, Math.floor(box.scrollTop / tall)) - 8);
    const last = Math.min(order.length, first + Math.ceil(box.clientHeight / tall) + 24);
    const rows = order.slice(first, last).map(cellsOf);
    body.replaceChildren(...(first ? [gap(first)] : []), ...rows, ...(last < order.length ? [gap(order.length - last)] : []));
    if (rows.length) tall = rows[0].getBoundingClientRect().height || tall;
    drawn = first + " " + last;
  }
  let due = 0;
  box.addEventListener("scroll", () => { if (!due) due = requestAnimationFrame(() => { due = 0; draw(); }); });
  function sortBy(name, falling) {
    by = name; down = falling;
    heads.forEach((head, k) => {
      if (COLUMNS[k] === name) head.setAttribute("aria-sort", falling ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    });
    box.scrollTop = 0; arrange();
  }
  heads.forEach((head, k) => head.querySelector("button").addEventListener("click", () =>
    sortBy(COLUMNS[k], by === COLUMNS[k] ? !down : !SMALL_FIRST.includes(COLUMNS[k]))));
  filter.addEventListener("input", () => { box.scrollTop = 0; arrange(); });
  body.addEventListener("click", (event) => {
    const row = event.target.closest("tr[data-episode]");
    if (row) choose(Number(row.dataset.episode));
  });
  function mark(episode) { chosen = episode; for (const row of body.rows) row.className = row.className === "gap" ? "gap" : Number(row.dataset.episode) === episode ? "chosen" : ""; }
  // The worst; the one in the middle; the worst of those in which nobody comes near another.
  const PICKS = {
    worst: (all) => all[0],
    typical: (all) => all.filter((e) => data.end[e] < Infinity)[Math.floor(all.filter((e) => data.end[e] < Infinity).length / 2)],
    odd: (all) => { const gaps = all.map((e) => data.closest[e]).sort((a, b) => a - b), half = gaps[Math.floor(gaps.length / 2)]; return all.find((e) => data.closest[e] >= half); },
  };
  function pick(which) {
    const all = [...known.keys()].filter((e) => known[e] && !Number.isNaN(data.end[e])).sort((a, b) => data.end[b] - data.end[a] || a - b);
    const found = PICKS[which](all);
    if (found !== undefined) choose(found);
  }
  return { reset, forget, take, mark, pick, complete: () => known !== null && known.every((x) => x) };
}
