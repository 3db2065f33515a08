// Starts rerun's viewer over the recordings in `shown.files`, and takes the poster away when the
// first of them is drawn. `shown.at`: nanoseconds at which they stand still, or null to play.
"use strict";
const poster = document.getElementById("poster"), state = document.getElementById("state");
// rerun writes thousands of lines of its work here, which take longer than its work; and it reports
// what is looked at. The page's policy lets no report out; here it is answered before it is asked.
console.debug = () => {};
const asking = window.fetch;
window.fetch = async (what, ...more) => {
  const whom = new URL(what.url ?? what, location.href);
  return whom.origin === location.origin ? asking(what, ...more) : new Response(null, { status: 204 });
};
const here = new URL(".", location.href);
const frames = async (count) => { for (; count; count--) await new Promise(requestAnimationFrame); };

function trouble(error) {
  state.textContent = `The viewer cannot be shown here (${error}). vidphys view without --web opens it in a window.`;
  state.className = "callout";
  poster.hidden = false;
}

// A message of protobuf: a field of bytes, and one of a number.
const bytes = (field, content) => [field * 8 + 2, content.length, ...content];
function number(field, value) {
  const digits = [];
  for (let rest = BigInt(value); ; rest >>= 7n) {
    digits.push(Number(rest & 127n) | (rest > 127n ? 128 : 0));
    if (rest <= 127n) return [field * 8, ...digits];
  }
}

// Two requests of rerun's viewer control (its viewer_control.proto): a recording, which plays at
// first, is halted (11, RunCommand) and led to a moment of its timeline (6, SetTimeCursor).
async function stand(handle, event) {
  const text = (field, word) => bytes(field, [...new TextEncoder().encode(word)]);
  const store = `Recording:${event.application_id.replace(/[\\:]/g, "\\$&")}:${event.recording_id}`;
  const ask = (kind, content) => handle.viewer_control(new Uint8Array(bytes(kind, content)));
  await ask(11, [...text(1, "recording.toggle_play_pause"), ...text(2, store)]);
  await ask(6, [...text(1, store), ...bytes(2, text(1, "sim_time")), ...bytes(3, number(1, shown.at))]);
}

async function drawn(handle, event) {
  await frames(3); // it has to read the layout before it can be told where to stand
  if (shown.at !== null) await stand(handle, event);
  await frames(2);
  document.body.dataset.drawn = Math.round(performance.now());
  poster.hidden = true;
  document.getElementById("viewer").focus();
}

async function start() {
  await document.querySelector("img")?.decode();
  await frames(2); // what stands until then is seen at once
  await wasm_bindgen({ module_or_path: "re_viewer_bg.wasm" });
  document.body.dataset.loaded = Math.round(performance.now());
  let handle;
  const told = (text) => {
    const event = JSON.parse(text);
    if (event.type === "recording_open") drawn(handle, event).catch(trouble);
  };
  handle = new wasm_bindgen.WebHandle({
    url: shown.files.map((file) => new URL(file, here).href),
    hide_welcome_screen: true,
    render_backend: "webgl", // without a GPU the other says so, and is left after a second
    check_for_updates_on_startup: false,
    persist: false,
    enable_history: false,
    theme: matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark",
    on_viewer_event: told,
  });
  await handle.start(document.getElementById("viewer"));
  (function check() {
    if (handle.has_panicked()) trouble(handle.panic_message());
    else setTimeout(check, 1000);
  })();
}

start().catch(trouble);
