// Buttons, sliders and fields with labels. Data are inserted as text only.

import { fixed, make } from "./plots.js";

export const byId = (id) => document.getElementById(id);

/** Sets the text of an element if it is another, so that live regions are not announced again. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** A button that calls `action`. A click by pointer returns the keyboard to the page. */
export function button(text, action, attributes = {}) {
  const node = make("button", { type: "button", ...attributes }, text);
  node.addEventListener("click", (event) => {
    action(event);
    if (event.detail > 0) node.blur();
  });
  return node;
}

/** A group of buttons of which one is pressed. `options` are `[value, text, title]`. */
export function choice(parent, options, action) {
  parent.replaceChildren();
  const buttons = options.map(([value, text, title]) => {
    const node = button(text, () => action(value), { "data-value": value, "aria-pressed": false, ...(title ? { title } : {}) });
    parent.append(node);
    return node;
  });
  return {
    set: (value) => buttons.forEach((node) => {
      const is = String(node.dataset.value === String(value));
      if (node.getAttribute("aria-pressed") !== is) node.setAttribute("aria-pressed", is);
    }),
    disable: (disabled) => buttons.forEach((node) => { node.disabled = disabled; }),
  };
}

/** A slider with its value and unit at the right. Values of the server do not move it while it is held. */
export function slider(parent, { name, text, unit, min, max, step, digits = 1, action }) {
  const row = parent.appendChild(make("label", { class: "row" }));
  row.append(make("span", {}, text));
  const input = row.appendChild(make("input", { type: "range", min, max, step, value: 0, id: `slider-${name}`, title: "A double click sets 0" }));
  const output = row.appendChild(make("output", { class: "numbers" }));
  let held = false;
  const show = () => setText(output, `${fixed(Number(input.value), digits)} ${unit}`);
  input.addEventListener("pointerdown", () => { held = true; });
  for (const end of ["pointerup", "pointercancel"]) input.addEventListener(end, () => { held = false; input.blur(); });
  input.addEventListener("input", () => { show(); action(Number(input.value)); });
  input.addEventListener("dblclick", () => { input.value = 0; show(); action(0); });
  show();
  return {
    input,
    set: (value) => { if (!held && document.activeElement !== input) { input.value = value; show(); } },
    disable: (disabled) => { input.disabled = disabled; },
  };
}

/** A row of a label and a field; `action` receives the element after a change. */
export function field(parent, text, node, action) {
  const row = parent.appendChild(make("label", { class: "row" }));
  row.append(make("span", {}, text), node);
  node.addEventListener("change", () => {
    action(node);
    if (node.tagName === "SELECT" || node.type === "checkbox") node.blur();
  });
  return node;
}

/** A drop-down list; `options` are `[value, text]`. */
export function select(options, attributes = {}) {
  const node = make("select", attributes);
  fill(node, options);
  return node;
}

export function fill(node, options) {
  node.replaceChildren(...options.map(([value, text]) => make("option", { value }, text)));
}

/** Sets the value of a field, adding it to a list that lacks it, unless the field is in use. */
export function setField(node, value) {
  if (document.activeElement === node) return;
  if (node.type === "checkbox") node.checked = Boolean(value);
  else {
    const text = String(value ?? "");
    if (node.tagName === "SELECT" && ![...node.options].some((option) => option.value === text)) node.append(make("option", { value: text }, text));
    node.value = text;
  }
}
