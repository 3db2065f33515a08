// A stage: what is asked goes to Python, which rolls it; pieces of its answer are drawn as they come.
(() => {
  const by = (id) => document.getElementById(id);
  const stage = by("stage"), sheet = by("sheet"), power = by("energy");
  const plain = (x, digits = 3) => x === null || x === undefined ? "–"
    : Number(x.toPrecision(digits)).toString().replace("-", "\u2212");
  const count = (x) => x.toLocaleString("en");
  let told = null, asked = null, ways = {}, energy = {}, head = null, lawful = "";
  let view = { x: 0, y: 0, size: 2 }, since = 0, spent = [], troubles = [];

  // --- what is asked, and its answer ------------------------------------------------------------
  // A stream of pieces: two lengths, JSON, bytes.
  async function* pieces(kind, body, signal) {
    const answer = await fetch(kind, { method: "POST", body, signal });
    if (!answer.ok) throw new Error(await answer.text());
    const reader = answer.body.getReader();
    let kept = new Uint8Array(0);
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      const joined = new Uint8Array(kept.length + value.length);
      joined.set(kept); joined.set(value, kept.length); kept = joined;
      while (kept.length >= 8) {
        const sizes = new DataView(kept.buffer, kept.byteOffset), text = sizes.getUint32(0, true);
        const end = 8 + text + sizes.getUint32(4, true);
        if (kept.length < end) break;
        const about = JSON.parse(new TextDecoder().decode(kept.subarray(8, 8 + text)));
        yield [about, kept.slice(8 + text, end).buffer];
        kept = kept.slice(end);
      }
    }
  }
  // One question at a time: a change that comes while none is answered waits, and only the newest.
  let stop = null, waiting = false, wanted = false;
  function change() {
    if (!told) return;
    if (!since) since = performance.now();
    wanted = true;
    if (!waiting) ask();
  }
  async function ask() {
    if (stop) stop.abort();
    const mine = stop = new AbortController();
    const began = since;
    wanted = false; waiting = true; since = 0;
    try {
      for await (const [about, numbers] of pieces("roll", JSON.stringify(asked), mine.signal)) {
        if (mine !== stop) return;
        take(about, new Float32Array(numbers), began);
        if (waiting) { waiting = false; if (wanted) { ask(); return; } }
      }
      if (!table.complete() && told.truth) await survey(mine);
    } catch (error) {
      if (mine !== stop || error.name === "AbortError") return;
      troubles = [error.message]; tell();
    }
    if (mine === stop) { waiting = false; if (wanted) ask(); }
  }
  // What becomes of all episodes, when what is seen is done: a change comes first.
  async function survey(mine) {
    for await (const [about] of pieces("survey", JSON.stringify(asked), mine.signal)) {
      if (mine !== stop) return;
      if (about.role === "table") table.take(about);
      if (about.said) throw new Error(about.said[0]);
    }
    by("episodes").removeAttribute("aria-busy");
  }
  function take(about, numbers, began) {
    if (about.role === "table") {
      table.take({ ...about, rows: { ...about.rows, left: head.left, bad: head.bad } });
      if (table.complete()) by("episodes").removeAttribute("aria-busy");
      stage.dataset.told = about.rows.error ? "all" : "some";
      return;
    }
    const fresh = about.role === "model" && about.first === 0;
    if (fresh) {
      ways = {}; energy = {}; troubles = []; head = about;
      const law = JSON.stringify([asked.coupling, asked.factors, asked.integrator, asked.dt]);
      if (law !== lawful) { lawful = law; table.forget(told, asked.coupling); by("episodes").setAttribute("aria-busy", "true"); }
    }
    for (const text of about.said || []) troubles.push(text);
    if (about.shape) {
      const [e, t, n, d] = about.shape;
      const way = ways[about.role] || (ways[about.role] = { episode: about.episode, dt: about.dt, e, n, d, parts: [], stored: 0 });
      way.parts.push({ first: about.first, t, numbers }); way.stored = about.first + t;
    }
    if (about.energy) for (const [name, values] of Object.entries(about.energy)) {
      const key = about.role + " " + name;
      energy[key] = { dt: about.dt, values: (energy[key] ? energy[key].values : []).concat(values) };
    }
    if (about.role === "model" && !fresh) {
      head.ms = about.ms;
      for (const name of ["left", "bad"]) head[name] = head[name].map((x, k) => x >= 0 ? x : about[name][k] >= 0 ? about.first + about[name][k] : -1);
    }
    if (about.role === "model") stale = true;
    if (fresh) show(began); else showLater();
  }

  // --- places ------------------------------------------------------------------------------------
  const here = () => asked.episode - head.episode;  // among those that are rolled
  const held = (way, episode) => way && episode >= way.episode && episode < way.episode + way.e;
  // Place of a body at a stored state; null where it is not known.
  function place(way, episode, k, n) {
    for (const part of way.parts) {
      if (k < part.first || k >= part.first + part.t) continue;
      const at = (((episode - way.episode) * part.t + k - part.first) * way.n + n) * way.d;
      const x = part.numbers[at], y = way.d > 1 ? part.numbers[at + 1] : 0;
      return Number.isFinite(x) && Number.isFinite(y) ? [x, y] : null;
    }
    return null;
  }
  const NICE = [1, 1.5, 2, 3, 5, 7.5];
  const round = (x) => { const ten = 10 ** Math.floor(Math.log10(x)); return ten * (NICE.find((k) => k * ten >= x) || 10); };
  // The square that holds the start and nine tenths of the way.
  function frame(way, episode, thin) {
    const xs = [], ys = [];
    for (let n = 0; n < way.n; n++) for (let k = 0; k < way.stored; k += thin) {
      const at = place(way, episode, k, n);
      if (at) { xs.push(at[0]); ys.push(at[1]); }
    }
    if (!xs.length) return { x: 0, y: 0, size: 1 };
    xs.sort((a, b) => a - b); ys.sort((a, b) => a - b);
    const low = Math.floor(xs.length * .03), high = xs.length - 1 - low;
    const x = (xs[low] + xs[high]) / 2, y = (ys[low] + ys[high]) / 2;
    const half = 0.62 * Math.max(xs[high] - xs[low], ys[high] - ys[low], 1e-6);
    const near = Math.max(Math.abs(x), Math.abs(y)) < half / 4;  // the origin stays in the middle
    const size = round(near ? half + Math.max(Math.abs(x), Math.abs(y)) : half);
    return { x: near ? 0 : x, y: near ? 0 : y, size };
  }
  const start = () => {
    const bodies = told.mass[0].length, d = told.q[0].length / bodies, rows = (flat) => {
      const all = flat[asked.episode];
      return Array.from({ length: bodies }, (_, n) => all.slice(n * d, (n + 1) * d));
    };
    return { q: asked.q || rows(told.q), v: told.v && (asked.v || rows(told.v)) };
  };

  // --- pictures ----------------------------------------------------------------------------------
  const tone = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  // A drawing is as many points wide on a phone as on a desk: its words are made as large as the page's.
  const words = (canvas) => `${Math.round(13 * canvas.width / (canvas.clientWidth || canvas.width))}px system-ui`;
  const CALM = 60;  // milliseconds between pictures of what comes after the model's answer
  let due = 0, later = 0, timed = 0, stale = true;
  const show = (began) => {
    if (began) timed = began;
    if (!due) due = requestAnimationFrame(draw);
  };
  const showLater = () => { if (!later) later = setTimeout(() => { later = 0; show(0); }, CALM); };
  function draw() {
    due = 0;
    const model = ways.model;
    if (!model) return;
    if (!dragging) view = frame(model, asked.episode, 4);
    drawStage(model); drawEnergy(); tell();
    if (stale) { stale = false; drawSheet(model); }
    if (timed) {
      const began = timed; timed = 0;
      requestAnimationFrame(() => {  // the frame has been handed over when the next one begins
        const ms = performance.now() - began;
        spent.push(ms); stage.dataset.ms = ms.toFixed(1); stage.dataset.drawn = spent.length;
        tell();
      });
    }
  }
  const onStage = (x, y) => {
    const size = stage.width;
    return [size / 2 * (1 + (x - view.x) / view.size), size / 2 * (1 - (y - view.y) / view.size)];
  };
  function line(pen, way, episode, n, until, at) {
    pen.beginPath();
    // Far outside it ends: of a line without end a browser draws no dashes.
    const far = 4 * stage.width;
    for (let k = 0, last = null; k < until; k++) {
      const p = place(way, episode, k, n);
      if (!p) continue;
      const [x, y] = at(p[0], p[1]), gap = last ? Math.hypot(x - last[0], y - last[1]) : 0, part = Math.min(1, far / gap);
      if (last) pen.lineTo(last[0] + part * (x - last[0]), last[1] + part * (y - last[1])); else pen.moveTo(x, y);
      last = [x, y];
      if (part < 1 || Math.abs(x) > far || Math.abs(y) > far) break;
    }
    pen.stroke();
  }
  const now = () => Number(by("time").value);
  function drawStage(model) {
    const pen = stage.getContext("2d"), size = stage.width, grey = tone("--ghost"), shown = asked.episode;
    pen.clearRect(0, 0, size, size);
    const ghost = ways.truth || ways.held, seconds = now() * (model.stored - 1) * model.dt;
    const until = (way) => Math.min(way.stored, Math.floor(seconds / way.dt + 1e-6) + 1);
    for (let n = 0; n < model.n; n++) {
      const hue = HUES[n % HUES.length];
      if (held(ghost, shown)) {
        pen.strokeStyle = grey; pen.lineWidth = 5;
        line(pen, ghost, shown, n, until(ghost), onStage);
      }
      if (held(ways.twin, shown)) {
        pen.strokeStyle = hue; pen.lineWidth = 1.5; pen.setLineDash([5, 5]);
        line(pen, ways.twin, shown, n, until(ways.twin), onStage); pen.setLineDash([]);
      }
      pen.strokeStyle = hue; pen.lineWidth = 2.5;
      line(pen, model, shown, n, until(model), onStage);
      const last = place(model, shown, until(model) - 1, n);
      pen.fillStyle = hue;
      if (last) { pen.beginPath(); pen.arc(...onStage(...last), 6, 0, 7); pen.fill(); }
      mark(pen, model, n);
    }
    drawStart(pen);
    drawScale(pen, size);
  }
  function mark(pen, model, n) {
    const k = head.left[here()], at = k >= 0 && place(model, asked.episode, k, n);
    if (!at) return;
    const [x, y] = onStage(...at);
    pen.strokeStyle = tone("--bad"); pen.lineWidth = 3; pen.beginPath();
    pen.moveTo(x - 7, y - 7); pen.lineTo(x + 7, y + 7); pen.moveTo(x - 7, y + 7); pen.lineTo(x + 7, y - 7); pen.stroke();
  }
  const ARROW = 0.25;  // of half of the picture, for the fastest body at the start
  const reach = () => {
    const { v } = start();
    return v && ARROW * view.size / Math.max(1e-9, ...told.v[asked.episode].map(Math.abs));
  };
  const tip = (q, v) => [q[0] + reach() * v[0], (q[1] || 0) + reach() * (v[1] || 0)];
  function drawStart(pen) {
    const { q, v } = start();
    q.forEach((place, n) => {
      const at = onStage(place[0], place[1] || 0);
      pen.strokeStyle = HUES[n % HUES.length]; pen.lineWidth = 2;
      pen.fillStyle = tone("--page"); pen.beginPath(); pen.arc(...at, 8, 0, 7); pen.fill(); pen.stroke();
      if (!v) return;
      const end = onStage(...tip(place, v[n]));
      pen.beginPath(); pen.moveTo(...at); pen.lineTo(...end); pen.stroke();
      pen.fillStyle = tone("--ink"); pen.beginPath(); pen.arc(...end, 4, 0, 7); pen.fill();
    });
  }
  function drawScale(pen, size) {
    const units = round(view.size / 4), wide = units / view.size * size / 2;
    pen.strokeStyle = pen.fillStyle = tone("--dim"); pen.lineWidth = 2; pen.font = words(stage);
    pen.beginPath(); pen.moveTo(16, size - 16); pen.lineTo(16 + wide, size - 16); pen.stroke();
    pen.fillText(plain(units), 16, size - 24);
  }
  function drawSheet(model) {
    const pen = sheet.getContext("2d"), side = Math.ceil(Math.sqrt(model.e)), size = sheet.width / side;
    pen.clearRect(0, 0, sheet.width, sheet.height);
    const thin = Math.max(1, Math.round(model.stored / 40)), bad = tone("--bad"), edge = tone("--line"), ink = tone("--ink");
    for (let e = 0; e < model.e; e++) {
      const episode = model.episode + e, box = frame(model, episode, thin), left = (e % side) * size, top = Math.floor(e / side) * size;
      pen.strokeStyle = episode === asked.episode ? ink : edge; pen.lineWidth = episode === asked.episode ? 3 : 1;
      pen.strokeRect(left + 2, top + 2, size - 4, size - 4);
      pen.save(); pen.beginPath(); pen.rect(left + 3, top + 3, size - 6, size - 6); pen.clip();
      pen.lineWidth = 1.2;
      for (let n = 0; n < model.n; n++) {
        pen.strokeStyle = HUES[n % HUES.length]; pen.beginPath();
        for (let k = 0; k < model.stored; k += thin) {
          const at = place(model, episode, k, n);
          if (at) pen.lineTo(left + size / 2 * (1 + (at[0] - box.x) / box.size), top + size / 2 * (1 - (at[1] - box.y) / box.size));
        }
        pen.stroke();
      }
      pen.restore();
      const said = head.bad[e] >= 0 ? "!" : head.left[e] >= 0 ? "×" : "";
      if (said) { pen.fillStyle = bad; pen.font = "bold 20px system-ui"; pen.fillText(said, left + size - 18, top + 21); }
    }
  }
  const LINES = [["truth true", "the truth", "--ghost", 5, []], ["model true", "the true law along the model's way", "--accent", 2.5, []],
    ["model own", "the model's own energy, begun at the true one", "--twin", 1.5, [6, 4]]];
  function drawEnergy() {
    const pen = power.getContext("2d"), wide = power.width, high = power.height, grey = tone("--dim");
    pen.clearRect(0, 0, wide, high);
    const there = LINES.filter(([name]) => energy[name]), model = ways.model;
    // An energy is known up to a constant: the model's own begins where the true one does.
    const [mine, real] = ["model own", "model true"].map((name) => energy[name] && energy[name].values[0]);
    const shift = Number.isFinite(mine) && Number.isFinite(real) ? real - mine : 0;
    const valuesOf = (name) => energy[name].values.map((x) => x === null || name !== "model own" ? x : x + shift);
    const values = there.flatMap(([name]) => valuesOf(name)).filter((x) => x !== null);
    by("energy-key").textContent = there.length ? "" : "This model has no energy.";
    if (!values.length) return;
    let low = Math.min(...values), top = Math.max(...values);
    const least = 0.1 * Math.max(Math.abs(low), Math.abs(top), 1e-9), middle = (low + top) / 2;
    if (top - low < least) { low = middle - least / 2; top = middle + least / 2; }
    pen.font = words(power);
    const end = head.steps / head.every * model.dt, tall = parseInt(pen.font), from = 8 + Math.max(...[low, middle, top].map((x) => pen.measureText(plain(x)).width));
    const at = (t, x) => [from + (wide - from - 10) * t / end, high - 12 - tall - (high - 28 - tall) * (x - low) / (top - low)];
    pen.strokeStyle = tone("--line"); pen.fillStyle = grey; pen.lineWidth = 1;
    for (const x of [low, middle, top]) {
      pen.beginPath(); pen.moveTo(...at(0, x)); pen.lineTo(...at(end, x)); pen.stroke();
      pen.fillText(plain(x), 4, at(0, x)[1] + tall / 3);
    }
    pen.fillText("0 s", from, high - 6); pen.fillText(plain(end) + " s", wide - 10 - pen.measureText(plain(end) + " s").width, high - 6);
    there.forEach(([name, , colour, width, dash]) => {
      pen.strokeStyle = tone(colour); pen.lineWidth = width; pen.setLineDash(dash); pen.beginPath();
      valuesOf(name).forEach((x, k) => { if (x !== null) pen.lineTo(...at(k * energy[name].dt, x)); });
      pen.stroke(); pen.setLineDash([]);
    });
    by("energy-key").replaceChildren(...there.flatMap(([, words, , width, dash]) => {
      const bold = document.createElement("b");
      bold.textContent = dash.length ? "Dashed" : width > 4 ? "Thick grey" : "Line";
      return [bold, `: ${words}. `];
    }));
  }

  // --- words -------------------------------------------------------------------------------------
  const status = (left, bad) => bad >= 0 ? `not finite at step ${count(bad * head.every)}`
    : left >= 0 ? `left its valid range at step ${count(left * head.every)}` : "ok";
  function tell() {
    by("warnings").hidden = !troubles.length;
    by("warnings").replaceChildren(...troubles.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
    if (!head || !ways.model) return;
    const all = head.left.length, left = head.left.filter((x) => x >= 0).length, bad = head.bad.filter((x) => x >= 0).length;
    const drawn = stage.dataset.ms ? `, drawn ${Math.round(Number(stage.dataset.ms))} ms after the change` : "";
    const done = ways.model.stored > head.steps / head.every;
    by("said").textContent = `${all} × ${count(head.steps)} steps${done ? ` rolled in ${Math.round(head.ms)} ms by ${head.backend}` : " …"}${drawn}. `
      + `This episode: ${here() in head.left ? status(head.left[here()], head.bad[here()]) : "…"}. ${left ? left + " of " + all + " leave their valid range" : "None leaves its valid range"}, ${bad ? bad + " are not finite" : "all are finite"}.`;
    const seconds = now() * (ways.model.stored - 1) * ways.model.dt;
    by("time-said").textContent = `${plain(seconds)} s`;
  }
  const table = episodeTable(by("episodes"), by("which"), by("counted"), (e) => choose(e));

  // --- what is moved -----------------------------------------------------------------------------
  function slider(name, low, high, value, set) {
    const label = document.createElement("label"), input = document.createElement("input"), out = document.createElement("output");
    Object.assign(input, { type: "range", min: low, max: high, step: 0.05, value });
    input.dataset.name = name;
    input.addEventListener("input", () => { out.textContent = set(Number(input.value)); change(); });
    label.append(name, input, out);
    return [label, input, out];
  }
  function sliders() {
    const law = by("law");
    law.replaceChildren();
    if (told.coupling) {
      const own = told.coupling[asked.episode];
      const [label, , out] = slider("coupling G", ...told.couplings, asked.coupling === null ? own : asked.coupling, (x) => { asked.coupling = x; return plain(x); });
      out.textContent = asked.coupling === null ? `${plain(own)}, each episode its own` : plain(asked.coupling);
      law.append(label);
    }
    for (const [name, [low, high]] of Object.entries(told.factors)) {
      const [label, , out] = slider(name, low, high, asked.factors[name] || 1, (x) => { asked.factors[name] = x; return "× " + plain(x); });
      out.textContent = "× " + plain(asked.factors[name] || 1);
      law.append(label);
    }
    if (!law.children.length) law.textContent = "This model has no number that can be changed.";
  }
  function choose(episode) {
    asked.episode = Math.max(0, Math.min(told.episodes - 1, episode)); asked.q = asked.v = null;
    by("episode").value = asked.episode;
    table.mark(asked.episode);
    sliders(); change();
  }
  function back() {
    asked = { cell: told.cell, episode: asked ? asked.episode : 0, coupling: null, factors: {}, q: null, v: null, integrator: null, dt: null };
    by("dt").value = 0; by("dt-said").textContent = `${plain(told.dt)} s`; by("dt").disabled = told.fixed_step;
    by("integrator").value = told.integrator || "";
    choose(asked.episode);
  }
  async function open() {
    told = null; if (stop) stop.abort(); waiting = false; since = 0; ways = {}; troubles = []; lawful = "";
    by("said").textContent = "Getting the model ready; the first time its law is compiled, which takes some seconds …";
    delete stage.dataset.drawn;
    try {
      for await (const [about] of pieces("open", by("cell").value)) {
        if (about.said) throw new Error(about.said[0]);
        if (about.cell !== by("cell").value) return;
        told = about;
      }
    } catch (error) { by("said").textContent = error.message; return; }
    const of = by("integrator"), named = told.integrators.length ? told.integrators : ["the model's own"];
    of.replaceChildren(...named.map((name) => new Option(name, name)));
    of.disabled = !told.integrators.length;
    by("episode").max = told.episodes - 1; by("episode-of").textContent = `of ${told.episodes}, counted from 0`;
    by("ghost-name").textContent = told.truth ? "the truth" : "the law that held";
    by("notes").replaceChildren(...told.notes.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
    by("sheet-title").textContent = told.episodes > told.at_once ? `The ${told.at_once} episodes around it` : "All episodes";
    by("each").hidden = !told.truth;
    table.reset(told, status); asked = null; back();
  }
  by("cell").addEventListener("change", open);
  by("episode").addEventListener("input", () => choose(Number(by("episode").value) || 0));
  by("back").addEventListener("click", () => told && back());
  by("integrator").addEventListener("change", () => { asked.integrator = by("integrator").value === told.integrator ? null : by("integrator").value; change(); });
  by("dt").addEventListener("input", () => {
    const dt = told.dt * 2 ** Number(by("dt").value);
    asked.dt = Number(by("dt").value) ? dt : null;
    by("dt-said").textContent = `${plain(dt)} s`; change();
  });
  for (const one of document.querySelectorAll("[data-pick]")) one.addEventListener("click", () => told && table.pick(one.dataset.pick));
  sheet.addEventListener("click", (event) => {
    const box = sheet.getBoundingClientRect(), side = Math.ceil(Math.sqrt(ways.model ? ways.model.e : 1));
    const e = Math.floor((event.clientY - box.top) / box.height * side) * side + Math.floor((event.clientX - box.left) / box.width * side);
    if (ways.model && e < ways.model.e) choose(ways.model.episode + e);
  });
  // The episode that is seen, as a file for the viewer.
  by("save").addEventListener("click", async () => {
    if (!told) return;
    by("saved").textContent = "Rolling it once more …";
    try {
      for await (const [about, bytes] of pieces("record", JSON.stringify(asked))) {
        if (about.said) throw new Error(about.said[0]);
        const link = document.createElement("a");
        link.href = URL.createObjectURL(new Blob([bytes])); link.download = about.name; link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 60000);
        by("saved").textContent = `Saved; look at it by: vidphys view ${about.name}`;
      }
    } catch (error) { by("saved").textContent = error.message; }
    if (!table.complete()) change();  // it had to wait for this
  });
  let dragging = null;
  const under = (event) => {
    const box = stage.getBoundingClientRect();
    return [view.x + (2 * (event.clientX - box.left) / box.width - 1) * view.size,
      view.y + (1 - 2 * (event.clientY - box.top) / box.height) * view.size];
  };
  stage.addEventListener("pointerdown", (event) => {
    if (!told || !told.v) return;
    const [x, y] = under(event), { q, v } = start(), near = view.size / 12;
    const gap = (at) => Math.hypot(at[0] - x, (at[1] || 0) - y);
    const all = [...q.map((at, n) => ["q", n, gap(at)]), ...v.map((one, n) => ["v", n, gap(tip(q[n], one))])];
    const [what, n, far] = all.reduce((a, b) => b[2] < a[2] ? b : a);
    if (far > near) return;
    dragging = [what, n]; stage.setPointerCapture(event.pointerId); event.preventDefault();
  });
  stage.addEventListener("pointermove", (event) => {
    if (!dragging) return;
    const [what, n] = dragging, [x, y] = under(event), { q, v } = start();
    const next = (what === "q" ? q : v).map((row) => [...row]);
    if (what === "q") { next[n][0] = x; if (next[n].length > 1) next[n][1] = y; }
    else { next[n][0] = (x - q[n][0]) / reach(); if (next[n].length > 1) next[n][1] = (y - q[n][1]) / reach(); }
    asked[what] = next; change();
  });
  const drop = () => { if (dragging) { dragging = null; show(0); } };
  stage.addEventListener("pointerup", drop);
  stage.addEventListener("pointercancel", drop);
  // Eight seconds for all of it.
  let running = false, last = 0;
  const step = (time) => {
    if (!running) return;
    const next = now() + Math.min(time - last, 100) / 8000;
    last = time; by("time").value = next >= 1 ? 0 : next;
    show(0); requestAnimationFrame(step);
  };
  by("run").addEventListener("click", () => {
    running = !running; by("run").textContent = running ? "Pause" : "Play";
    if (running) { last = performance.now(); requestAnimationFrame(step); }
  });
  by("time").addEventListener("input", () => show(0));
  addEventListener("resize", () => show(0));
  open();
})();
