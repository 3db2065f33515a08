// What a reader would miss of a page: words and marks that hardly stand out, and its width.
const parts = (text) => { const v = (text.match(/[\d.]+/g) ?? []).map(Number); return v.length < 3 ? null : { c: v.slice(0, 3), a: v[3] ?? 1 }; };
const over = (top, under) => top.c.map((x, k) => x * top.a + under[k] * (1 - top.a));
const linear = (x) => (x / 255 <= 0.04045 ? x / 255 / 12.92 : ((x / 255 + 0.055) / 1.055) ** 2.4);
const light = (c) => 0.2126 * linear(c[0]) + 0.7152 * linear(c[1]) + 0.0722 * linear(c[2]);
const contrast = (a, b) => { const [low, high] = [light(a), light(b)].sort((x, y) => x - y); return (high + 0.05) / (low + 0.05); };
const ground = (e) => {
  const layers = [];
  for (; e; e = e.parentElement) {
    const painted = parts(getComputedStyle(e).backgroundColor);
    if (painted?.a) layers.push(painted);
    if (painted?.a === 1) break;
  }
  const empty = matchMedia("(prefers-color-scheme: dark)").matches ? [18, 18, 18] : [255, 255, 255];
  return layers.reduceRight((under, layer) => over(layer, under), empty);
};
document.querySelectorAll("details").forEach((each) => { each.open = true; });
const words = [], marks = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walk.nextNode()) {
  const text = walk.currentNode.textContent.trim(), e = walk.currentNode.parentElement;
  if (!text || e.closest("script, style, noscript, title, desc, defs") || !e.getClientRects().length) continue;
  const style = getComputedStyle(e), under = ground(e), ink = parts(e.closest("svg") ? style.fill : style.color);
  if (ink && contrast(over(ink, under), under) < 4.5) words.push(text.slice(0, 60));
}
for (const e of document.querySelectorAll("input[placeholder]")) {
  const under = ground(e), ink = parts(getComputedStyle(e, "::placeholder").color);
  if (contrast(over(ink, under), under) < 4.5) words.push(e.placeholder);
}
// Swatches that name the models, and what our own figures are made of but for their grid and bands.
for (const e of document.querySelectorAll("th.head i")) {
  const under = ground(e.parentElement);
  if (contrast(over(parts(getComputedStyle(e).backgroundColor), under), under) < 3) marks.push(e.outerHTML);
}
for (const e of document.querySelectorAll("svg[class] :is(circle, rect, path):not(.band, .grid, .skipped)")) {
  const style = getComputedStyle(e), under = ground(e.closest("svg"));
  const inks = [style.fill, style.stroke].map(parts).filter((ink) => ink);
  if (!inks.some((ink) => contrast(over(ink, under), under) >= 3)) marks.push(e.outerHTML.slice(0, 90));
}
return { width: document.documentElement.scrollWidth, words, marks };
