"use strict";
// The viewer of a scene: one transform for all panels, pictures drawn from the numbers themselves.

const viewer = $("viewer"), stage = $("stage"), readout = $("readout");
const state = { number: 0, cut: 0, source: 0, other: "truth", layer: "map", mode: "flip", measure: "", opacity: 1, zoom: 1, x: 0, y: 0 };
let scene = null, view = null, pictures = new Map(), panels = [], pointer = null, opening = 0;

const runOf = (source) => typeof source === "number" ? view.runs[page.runs[source]] : undefined;
const titleOf = (source) => typeof source === "number" ? page.runs[source] : source;

function errorAt(run, i) {
  if (run.error) return run.error[i];
  return run.values && view.truth ? Math.abs(run.values[i] - view.truth[i]) : NaN;
}

// Without truth there are no regions.
function kindAt(run, i) {
  if (!view.region || !(view.region[i] & 1)) return 0;
  if (Number.isNaN(run.values ? run.values[i] : errorAt(run, i))) return 5;
  return (run.wrong[i] ? 2 : 1) + (view.region[i] & 2 ? 2 : 0);
}

const place = (value, low, high, steps) =>
  Math.min(steps - 1, Math.max(0, Math.floor((value - low) / Math.max(high - low, 1e-9) * steps)));

// Over the image, pixels of which nothing is known are left out.
const over = (source) => Boolean(view.image) && source !== "image" && state.opacity < 1;

// Color of pixel i, for what is to be drawn, null where it is left out; null instead of a function: nothing to draw.
function painter(source, layer) {
  const run = runOf(source), none = over(source) ? null : page.none;
  const colored = (values, color) => values && ((i) => Number.isNaN(values[i]) ? none : color(values[i]));
  if (source === "truth" || source === "sensor" || (run && layer === "map")) {
    return colored(run ? run.values : view[source], (v) => page.scale[place(v, scene.low, scene.high, 256)]);
  }
  if (!run) return null;
  if (layer === "status") return run.status && ((i) => (scene.status[run.status[i]] || { color: page.none }).color);
  if (layer === "bound") return colored(run.bound, (v) => page.scale[place(Math.log(v), ...scene.bound.map(Math.log), 256)]);
  if (layer === "error") {
    const color = (i) => page.errors[kindAt(run, i)][place(errorAt(run, i) || 0, 0, scene.top, 64)];
    return (i) => none || view.region[i] & 1 ? color(i) : null;
  }
  const { values, shown } = run.confidence[state.measure] || {};
  return colored(values, (v) => Array(3).fill(place(v, ...shown, 256)));
}

function drawn(source, layer) {
  if (source === "image") return view.image;
  const key = `${source}/${typeof source === "number" ? layer : ""}/${layer === "confidence" ? state.measure : ""}/${over(source)}`;
  if (!pictures.has(key)) {
    const color = painter(source, layer);
    let canvas = null;
    if (color) {
      canvas = make("canvas", "", { width: view.width, height: view.height });
      const context = canvas.getContext("2d"), data = context.createImageData(view.width, view.height);
      const words = new Uint32Array(data.data.buffer);
      for (let i = 0; i < words.length; i++) {
        const rgb = color(i);
        // Bytes in the order of all machines that run browsers.
        words[i] = rgb ? 0xff000000 | rgb[2] << 16 | rgb[1] << 8 | rgb[0] : 0;
      }
      context.putImageData(data, 0, 0);
    }
    pictures.set(key, canvas);
  }
  return pictures.get(key);
}

function draw() {
  const ratio = window.devicePixelRatio || 1;
  for (const panel of panels) {
    const { canvas } = panel, box = canvas.getBoundingClientRect();
    const [w, h] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, box.width, box.height);
    context.imageSmoothingEnabled = state.zoom < 1;
    const split = state.mode === "swipe" ? box.width * $("swipe").value / 1000 : box.width;
    const parts = state.mode === "swipe" ? [[panel.source, 0, split], [state.other, split, box.width]] : [[panel.source, 0, split]];
    for (const [source, from, to] of parts) {
      const image = drawn(source, state.layer);
      context.save();
      context.beginPath();
      context.rect(from, 0, to - from, box.height);
      context.clip();
      const place = [state.x, state.y, view.width * state.zoom, view.height * state.zoom * view.tall];
      if (image) {
        if (over(source)) {
          context.drawImage(view.image, ...place);
          context.globalAlpha = state.opacity;
        }
        context.drawImage(image, ...place);
        context.globalAlpha = 1;
      } else {
        context.fillStyle = "#9aa5ad";
        context.font = "14px sans-serif";
        context.fillText(`no ${source === "image" ? "image" : runOf(source) ? state.layer : "map"}`, from + 12, 44);
      }
      context.restore();
    }
    drawSides(context, box);
    if (state.mode === "swipe") {
      context.fillStyle = "#fff";
      context.fillRect(split - 1, 0, 2, box.height);
    }
    if (pointer && state.mode === "all") {
      const [x, y] = [(pointer.x + .5) * state.zoom + state.x, (pointer.y + .5) * state.zoom * view.tall + state.y];
      context.strokeStyle = "#fff";
      context.lineWidth = 1;
      context.strokeRect(x - 5, y - 5, 10, 10);
    }
  }
}

// Letters of the patient's sides at the edges of a slice, or of the panel where the slice reaches beyond.
function drawSides(context, box) {
  const [columns, rows] = view.axes;
  if (!columns) return;
  const [w, h] = [view.width * state.zoom, view.height * state.zoom * view.tall];
  const [left, right] = [Math.max(state.x, 0) + 12, Math.min(state.x + w, box.width) - 12];
  const [top, bottom] = [Math.max(state.y, 0) + 12, Math.min(state.y + h, box.height) - 12];
  Object.assign(context, { font: "bold 14px sans-serif", textAlign: "center", textBaseline: "middle", lineWidth: 3 });
  Object.assign(context, { fillStyle: "#fff", strokeStyle: "#000" });
  const places = [[(left + right) / 2, top, rows[1][0]], [(left + right) / 2, bottom, rows[1][1]],
    [left, (top + bottom) / 2, columns[1][0]], [right, (top + bottom) / 2, columns[1][1]]];
  for (const [x, y, letter] of places) {
    context.strokeText(letter, x, y);
    context.fillText(letter, x, y);
  }
  Object.assign(context, { textAlign: "start", textBaseline: "alphabetic" });
}

function fit() {
  const box = panels[0].canvas.getBoundingClientRect();
  state.zoom = Math.min(box.width / view.width, box.height / (view.height * view.tall)) || 1;
  state.x = (box.width - view.width * state.zoom) / 2;
  state.y = (box.height - view.height * state.zoom * view.tall) / 2;
  draw();
}

function zoom(factor, x, y) {
  const next = Math.min(64, Math.max(.02, state.zoom * factor)), change = next / state.zoom;
  state.x = x - (x - state.x) * change;
  state.y = y - (y - state.y) * change;
  state.zoom = next;
  draw();
}

const middle = () => { const box = panels[0].canvas.getBoundingClientRect(); return [box.width / 2, box.height / 2]; };

// What can be chosen: image, truth, and runs by number.
const choices = () => ["image", ...(view.sensor ? ["sensor"] : []), ...(view.region ? ["truth"] : []), ...page.runs.keys()].filter((s) => typeof s !== "number" || view.region || runOf(s));

function setPanels() {
  const sources = state.mode === "all" ? choices() : [state.source];
  const box = stage.getBoundingClientRect();
  const aspect = view.width / (view.height * view.tall);
  let columns = 1, best = 0;
  for (let n = 1; n <= sources.length; n++) {
    const w = box.width / n, h = box.height / Math.ceil(sources.length / n);
    const size = Math.min(w, h * aspect);
    if (size > best) [best, columns] = [size, n];
  }
  stage.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
  stage.style.gridAutoRows = "minmax(0, 1fr)";
  panels = sources.map((source) => ({ source, canvas: make("canvas") }));
  stage.replaceChildren(...panels.map(({ source, canvas }) => {
    const figure = make("figure"), right = state.mode === "swipe" ? ` | ${titleOf(state.other)}` : "";
    figure.append(canvas, make("figcaption", titleOf(source) + right));
    return figure;
  }));
}

function ramp(colors, width = 90) {
  const canvas = make("canvas", "", { width, height: 12 }), context = canvas.getContext("2d");
  for (let x = 0; x < width; x++) {
    context.fillStyle = `rgb(${colors[Math.floor(x / width * colors.length)].join()})`;
    context.fillRect(x, 0, 1, 12);
  }
  return canvas;
}

const trueQuantity = () => `true ${scene.quantity.replace(/^expected /, "")}`;  // of an expected error the true one

function setLegend() {
  const shown = (value) => `${+value.toPrecision(4)}`, parts = [];
  const entry = (...nodes) => { const span = make("span"); span.append(...nodes); parts.push(span); };
  if (state.layer === "map") {
    entry(`${state.source === "truth" && state.mode !== "all" ? trueQuantity() : scene.quantity} ${shown(scene.low)}`, ramp(page.scale, 200), `${shown(scene.high)} ${scene.unit}`);
    entry(ramp([page.none], 16), "no value");
  } else if (state.layer === "bound") {
    const [low, high] = scene.bound, middle = Math.sqrt(low * high).toPrecision(2);
    entry(`bound of the error ${low}`, ramp(page.scale.slice(0, 128)), middle, ramp(page.scale.slice(128)), `${high} ${scene.unit}`);
  } else if (state.layer === "error") {
    scene.words.forEach((words, kind) => {
      if (words.includes("occluded") && !scene.hidden) return;
      const flat = kind === 0 || kind === 5;
      entry(flat ? "" : "0", ramp(page.errors[kind], flat ? 16 : 70), flat ? words : `${scene.top} ${scene.unit}: ${words}`);
    });
  } else if (state.layer === "status") {
    for (const [code, { words, color }] of Object.entries(scene.status)) entry(ramp([color], 16), `${code}: ${words}`);
    entry(page.measured);
  } else {
    entry(`confidence ${state.measure}: unsure`, ramp([...Array(256).keys()].map((v) => [v, v, v]), 120), "sure");
  }
  if (view.factor > 1) entry(`pictures at 1/${view.factor} of their size`);
  $("legend").replaceChildren(...parts);
}

const text = (value, digits = 2) =>
  value === Infinity ? "above the scale" : value === -Infinity ? "below the scale" : Number.isNaN(value) ? "-" : value.toFixed(digits);

function setReadout() {
  if (!pointer) {
    readout.textContent = "Point at a pixel to read it. Keys: 1 to 9 runs, t truth, i image" + (view.sensor ? ", g the map of the sensor" : "") + "; m map, e error, b bound, s status, c confidence; f flip, w swipe (Shift+number: right side), a all; + - r zoom; left and right: scenes" +
      (scene.views.length > 1 ? "; up and down: slices, v: another axis" : "") + (view.image ? "; o: over the image." : ".");
    return;
  }
  const i = pointer.y * view.width + pointer.x;
  const known = view.region ? view.region[i] & 1 : 1;
  const where = !view.region ? "" : known ? (view.region[i] & 2 ? ", occluded" : "") : ", truth unknown or not evaluated";
  const truth = view.truth ? ` · ${trueQuantity()} ${text(view.truth[i])} ${scene.unit}` : "";
  const place = view.axes.map((along, axis) => {
    const index = (axis ? pointer.y : pointer.x) * view.factor;
    if (!along) return `${"xy"[axis]} ${index}`;
    const [, ends, first, step] = along, at = first + step * index;
    return `${ends[at < 0 ? 1 : 0]} ${Math.abs(at).toFixed(1)} mm`;
  }).join(", ");
  const line = make("div", `${place}${view.name && `, ${view.name}`}${truth}${where}`);
  const table = make("table"), head = table.createTHead().insertRow();
  for (const title of ["run", `${scene.quantity}, ${scene.unit}`, `error, ${scene.unit}`, "", ...(scene.bound ? [`bound, ${scene.unit}`] : []), "status", "confidence"]) head.append(make("th", title));
  const body = table.createTBody();
  page.runs.forEach((name, number) => {
    const run = view.runs[name], row = body.insertRow();
    if (number === state.source || (state.mode === "swipe" && number === state.other)) row.className = "now";
    row.append(make("th", name));
    if (!run) return row.append(make("td", "no map"));
    const status = run.status && scene.status[run.status[i]];
    const confidences = Object.entries(run.confidence).map(([measure, { values }]) =>
      `${measure} ${Number.isFinite(values[i]) ? +values[i].toPrecision(4) : text(values[i])}`);
    const cells = [run.values ? text(run.values[i]) : "-", known ? text(errorAt(run, i)) : "-", view.region ? scene.words[kindAt(run, i)] : "",
      ...(scene.bound ? [run.bound ? text(run.bound[i]) : "-"] : []), status ? status.words : "-", confidences.join(", ") || "-"];
    for (const cell of cells) row.append(make("td", cell));
  });
  readout.replaceChildren(line, table);
}

function setButtons() {
  for (const button of $("modes").children) button.ariaPressed = `${button.dataset.mode === state.mode}`;
  for (const button of $("layers").children) {
    const { layer } = button.dataset, runs = Object.values(view.runs);
    button.disabled = layer === "status" ? !runs.some((run) => run.status)
      : layer === "confidence" ? !runs.some((run) => Object.keys(run.confidence).length)
      : layer === "bound" ? !scene.bound : layer === "error" && !view.region;
    button.ariaPressed = `${layer === state.layer}`;
  }
  const measures = [...new Set(Object.values(view.runs).flatMap((run) => Object.keys(run.confidence)))];
  if (!measures.includes(state.measure)) state.measure = measures[0] || "";
  $("measure").replaceChildren(...measures.map((name) => make("option", name)));
  $("measure").value = state.measure;
  $("measure").hidden = state.layer !== "confidence" || measures.length < 2;
  $("swipe").hidden = state.mode !== "swipe";
  const slices = slicesOf(view.axis);
  $("axis").replaceChildren(...axes().map((axis) => make("option", scene.views.find((each) => each.axis === axis).plane, { value: axis })));
  $("axis").value = view.axis;
  $("slice").max = slices.length - 1;
  $("slice").value = slices.indexOf(state.cut);
  $("where").textContent = view.name;
  $("slices").hidden = scene.views.length < 2;
  $("opacity").value = 100 * state.opacity;
  $("opacity").parentNode.hidden = !view.image;
  $("which").value = state.number;
  $("sources").replaceChildren(...choices().map((source) => {
    const key = typeof source === "number" ? (source < 9 ? `${source + 1}` : "") : source === "sensor" ? "g" : source[0];
    const button = make("button", ` ${titleOf(source)}`);
    button.prepend(make("b", key));
    const both = state.mode === "swipe" && source === state.other;
    button.ariaPressed = `${state.mode !== "all" && (source === state.source || both)}`;
    button.onclick = (event) => choose(source, event.shiftKey);
    return button;
  }));
}

function show() {
  setButtons();
  setLegend();
  setPanels();
  setReadout();
  draw();
}

function change(what) {
  Object.assign(state, what);
  show();
}

function choose(source, right = false) {
  if (state.mode === "all") setMode("flip");
  change({ [right && state.mode === "swipe" ? "other" : "source"]: source });
}

function setMode(mode) {
  change({ mode });
  fit();
}

function setLayer(layer) {
  if (![...$("layers").children].find((button) => button.dataset.layer === layer).disabled) change({ layer });
}

const axes = () => [...new Set(scene.views.map((each) => each.axis))];
const slicesOf = (axis) => [...scene.views.keys()].filter((number) => scene.views[number].axis === axis);

function setSlice(number) {
  if (!(number in scene.views) || number === state.cut) return;
  state.cut = number;
  open(state.number);
}

// Across another axis, in the middle.
function setAxis(axis) {
  const slices = slicesOf(axis);
  setSlice(slices[slices.length >> 1]);
}

function step(by) {
  const slices = slicesOf(view.axis);
  setSlice(slices[slices.indexOf(state.cut) + by]);
}

async function open(number, source) {
  const mine = ++opening;
  viewer.dataset.ready = "";
  if (!viewer.open) viewer.showModal();
  const data = await sceneData(number);
  const other = scene !== data;
  const cut = other ? data.start : state.cut;
  const next = await unpackView(data.views[cut]);
  if (mine !== opening) return;  // another scene was asked for meanwhile
  const sameSize = view && view.width === next.width && view.height === next.height && !other;
  [scene, view, pictures, pointer] = [data, next, new Map(), null];
  if (other) state.opacity = data.opacity;
  state.cut = cut;
  state.number = number;
  if (source !== undefined) state.source = source;
  if (state.other === "truth" && page.runs.length > 1) state.other = state.source === 1 ? 0 : 1;
  if (other && (["bound", "status", "confidence"].includes(state.layer) || !view.region)) state.layer = "map";
  if (!choices().includes(state.source)) state.source = choices().at(-1);
  if (state.other === "truth" && !view.region) state.other = "image";
  show();
  if (!sameSize) fit();
  viewer.dataset.ready = `${number}`;
}

function follow() {
  const found = /^#scene-(\d+)(?:\/(.+))?$/.exec(location.hash);
  if (!found || !(Number(found[1]) < page.assets.length)) return;
  const which = found[2], source = ["truth", "image", "sensor"].includes(which) ? which : which ? Number(which) - 1 : undefined;
  open(Number(found[1]), typeof source === "number" && !(source in page.runs) ? 0 : source);
}

function go(number) {
  const n = page.assets.length;
  open((number + n) % n);
}

readout.style.setProperty("--rows", page.runs.length);  // its room is there from the start: pictures stay in place
if (page.assets.length) {
  page.assets.forEach((_, number) => $("which").append(make("option", document.querySelector(`#scene-${number} h3`).textContent, { value: number })));
  addEventListener("hashchange", follow);
  follow();
}
viewer.addEventListener("close", () => { opening++; history.replaceState(null, "", location.pathname + location.search); });
$("close").onclick = () => viewer.close();
$("which").onchange = () => go(Number($("which").value));
$("back").onclick = () => go(state.number - 1);
$("on").onclick = () => go(state.number + 1);
$("axis").onchange = () => setAxis(Number($("axis").value));
$("slice").oninput = () => setSlice(slicesOf(view.axis)[Number($("slice").value)]);
$("opacity").oninput = () => change({ opacity: $("opacity").value / 100 });
$("measure").onchange = () => change({ measure: $("measure").value });
$("closer").onclick = () => zoom(1.5, ...middle());
$("wider").onclick = () => zoom(1 / 1.5, ...middle());
$("fit").onclick = fit;
$("swipe").oninput = draw;
for (const button of $("modes").children) button.onclick = () => setMode(button.dataset.mode);
for (const button of $("layers").children) button.onclick = () => setLayer(button.dataset.layer);
addEventListener("resize", () => { if (viewer.open && view) { setPanels(); fit(); } });

addEventListener("keydown", (event) => {
  if (!viewer.open || !view || event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
  if (event.target.tagName === "INPUT" && event.key.startsWith("Arrow")) return;
  const digit = /^(?:Digit|Numpad)(\d)$/.exec(event.code);
  const keys = { t: () => view.region && choose("truth"), 0: () => view.region && choose("truth"), i: () => choose("image"), f: () => setMode("flip"),
    w: () => setMode("swipe"), a: () => setMode("all"), m: () => setLayer("map"), e: () => setLayer("error"), b: () => setLayer("bound"),
    s: () => setLayer("status"), g: () => view.sensor && choose("sensor"), c: () => setLayer("confidence"), r: fit, "+": $("closer").onclick, "=": $("closer").onclick,
    "-": $("wider").onclick, ArrowLeft: $("back").onclick, ArrowRight: $("on").onclick,
    ArrowUp: () => step(1), ArrowDown: () => step(-1), v: () => setAxis(axes()[(axes().indexOf(view.axis) + 1) % axes().length]),
    o: () => view.image && change({ opacity: state.opacity < 1 ? 1 : .6 }) };
  if (digit && Number(digit[1]) > 0) {
    if (Number(digit[1]) <= page.runs.length) choose(Number(digit[1]) - 1, event.shiftKey);
  } else if (event.key in keys) keys[event.key]();
  else return;
  event.preventDefault();
});

// Pointers: one drags, two pinch, none pressed reads values.
const held = new Map();
const at = (event) => { const box = event.target.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
const apart = () => { const [a, b] = [...held.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
stage.addEventListener("pointerdown", (event) => { held.set(event.pointerId, at(event)); stage.setPointerCapture && event.target.setPointerCapture(event.pointerId); read(event); });
for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, (event) => held.delete(event.pointerId));
stage.addEventListener("pointermove", (event) => {
  if (!view || event.target.tagName !== "CANVAS") return;
  const before = held.get(event.pointerId), now = at(event);
  if (before && held.size === 1) {
    state.x += now[0] - before[0];
    state.y += now[1] - before[1];
    held.set(event.pointerId, now);
    draw();
  } else if (before) {
    const was = apart();
    held.set(event.pointerId, now);
    if (was > 0) zoom(apart() / was, ...now);
  } else read(event);
});
stage.addEventListener("wheel", (event) => { event.preventDefault(); if (view) zoom(Math.exp(-event.deltaY / 400), ...at(event)); }, { passive: false });
stage.addEventListener("dblclick", fit);

function read(event) {
  if (!view || event.target.tagName !== "CANVAS") return;
  const [x, y] = at(event).map((value, axis) =>
    Math.floor((value - (axis ? state.y : state.x)) / (state.zoom * (axis ? view.tall : 1))));
  const inside = x >= 0 && y >= 0 && x < view.width && y < view.height;
  const next = inside ? { x, y } : null;
  if (next && pointer && next.x === pointer.x && next.y === pointer.y) return;
  pointer = next;
  setReadout();
  if (state.mode === "all") draw();
}
