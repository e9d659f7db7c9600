// Curves as SVG: shared by the page of a rollout and the live page.

const SVG = new Set(["svg", "g", "rect", "line", "path", "text", "polygon", "circle"]);

/** Creates an element of HTML or SVG with attributes and, if given, text. */
export function make(tag, attributes = {}, text = null) {
  const node = SVG.has(tag) ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (text !== null) node.textContent = text;
  return node;
}

/** Three to six round numbers between `low` and `high`. */
export function ticks(low, high) {
  const rough = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((s) => s * power).find((s) => s >= rough);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++) found.push(i * step);
  return found;
}

/** A number with fixed decimals; zero has no sign. */
export function fixed(value, digits) {
  return value.toFixed(digits).replace(/^-(?=[0.]+$)/, "");
}

/**
 * Draws `values` (null where unknown) over `times` (seconds, increasing) into an empty SVG of its present
 * size, with gaps where a value is unknown. `zero` includes 0 in the range, `zeroLine` emphasizes it, and
 * `least` and `leastSpan` are the smallest ranges of values and times shown. Times up to `warmUntil` are
 * shaded; null shades none.
 * Returns the cursor line, the number of known values, and functions that place the cursor and find a time.
 */
export function plotCurve(svg, { times, values, zero = true, zeroLine = false, least = 1e-3, leastSpan = 1e-6, warmUntil = null, digits = 2, value = null }) {
  const known = values.filter((value) => value !== null);
  const [w, h, left, right, top, bottom] = [Math.max(200, svg.clientWidth), svg.clientHeight || 130, 44, 14, 8, 18];
  svg.setAttribute("viewBox", `0 0 ${w} ${h}`);
  const base = zero || !known.length ? [0] : [];
  let [low, high] = [Math.min(...known, ...base), Math.max(...known, ...base)];
  if (high - low < least) [low, high] = least > 1e-3 ? [Math.min(low, (low + high - least) / 2), Math.max(high, (low + high + least) / 2)] : [low - 0.5, high + 0.5];
  const t0 = times.length ? times[0] : 0;
  const t1 = Math.max(times.length ? times[times.length - 1] : 1, t0 + leastSpan);
  const x = (t) => left + (w - left - right) * (t - t0) / (t1 - t0);
  const y = (v) => top + (h - top - bottom) * (high - v) / (high - low);
  const warmEnd = warmUntil === null ? left : x(Math.max(t0, Math.min(t1, warmUntil)));
  if (warmEnd > left) svg.append(make("rect", { x: left, y: top, width: warmEnd - left, height: h - top - bottom, fill: "var(--warm)" }));
  for (const tick of ticks(low, high)) {
    const stroke = zeroLine && Math.abs(tick) < 1e-9 ? "var(--dim)" : "var(--line)";
    svg.append(make("line", { x1: left, x2: w - right, y1: y(tick), y2: y(tick), stroke, "vector-effect": "non-scaling-stroke" }));
    svg.append(make("text", { x: left - 6, y: y(tick) + 3.5, "text-anchor": "end" }, String(Number(tick.toPrecision(6)))));
  }
  for (const tick of ticks(t0, t1)) svg.append(make("text", { x: x(tick), y: h - 5, "text-anchor": "middle" }, `${Number(tick.toPrecision(6))} s`));
  let d = "", pen = false;
  values.forEach((v, i) => {
    if (v !== null) d += `${pen ? "L" : "M"}${x(times[i]).toFixed(2)} ${y(v).toFixed(2)}`;
    pen = v !== null;
  });
  svg.append(make("path", { d, fill: "none", stroke: "var(--plot)", "stroke-width": 1.8, "stroke-linejoin": "round" }));
  const line = svg.appendChild(make("line", { y1: top, y2: h - bottom, stroke: "var(--alert)", "stroke-width": 1.2 }));
  const cursor = (i) => {
    line.setAttribute("x1", x(times[i]));
    line.setAttribute("x2", x(times[i]));
    if (value) value.textContent = values[i] === null ? "none" : fixed(values[i], digits);
  };
  // The time below the pointer.
  const timeAt = (event) => {
    const box = svg.getBoundingClientRect();
    return t0 + (t1 - t0) * ((event.clientX - box.left) / box.width * w - left) / (w - left - right);
  };
  return { cursor, timeAt, line, points: known.length };
}
