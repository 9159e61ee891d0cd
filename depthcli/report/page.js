"use strict";
// Tables that sort, and the numbers of a scene. The script of the viewer follows, in the same scope.
const $ = (id) => document.getElementById(id);
const make = (tag, text = "", more = {}) => Object.assign(document.createElement(tag), { textContent: text }, more);
const page = JSON.parse($("page").textContent);
document.documentElement.classList.add("js");

// Tables

const amount = (cell) => parseFloat(cell.textContent.trim().replace(/^> |\*$/g, ""));

function sort(table, column, head) {
  const down = head.getAttribute("aria-sort") === "ascending";
  for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const body = table.tBodies[0], rows = [...body.rows];
  const numeric = rows.some((row) => !Number.isNaN(amount(row.cells[column])));
  rows.sort((a, b) => {
    const [x, y] = [a.cells[column], b.cells[column]];
    if (!numeric) return x.textContent.localeCompare(y.textContent) * (down ? -1 : 1);
    const [v, w] = [amount(x), amount(y)];
    if (Number.isNaN(v) || Number.isNaN(w)) return Number.isNaN(v) - Number.isNaN(w);
    return down ? w - v : v - w;
  });
  body.append(...rows);
}

for (const table of document.querySelectorAll("table.sortable")) {
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    if ("plain" in head.dataset) return;
    head.tabIndex = 0;
    head.onclick = () => sort(table, column, head);
    head.onkeydown = (event) => { if (event.key === "Enter") head.onclick(); };
  });
}

for (const form of document.querySelectorAll("form.choose")) {
  const tables = [...form.parentNode.querySelectorAll(".matrix")];
  const [metric, region] = [form.querySelector(".metric"), form.querySelector(".region")];
  for (const [select, key] of [[metric, "metric"], [region, "region"]]) {
    for (const value of new Set(tables.map((table) => table.dataset[key]))) select.append(make("option", value));
    select.onchange = () => {
      const fits = (table) => table.dataset.metric === metric.value && table.dataset.region === region.value;
      const chosen = tables.find(fits) || tables.find((table) => table.dataset[key] === select.value);
      region.value = chosen.dataset.region;
      metric.value = chosen.dataset.metric;
      for (const table of tables) table.classList.toggle("on", table === chosen);
    };
  }
  form.hidden = tables.length < 2;
}

// Numbers of a scene

async function unpack(packed) {
  if (!packed) return null;
  const text = atob(packed.data), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer());
  if (packed.bits === 8) return raw;
  const n = raw.length / 2, values = new Float64Array(n);
  for (let i = 0, code = 0; i < n; i++) {
    code = (code + raw[i] + (raw[n + i] << 8)) & 0xffff;
    values[i] = code === 0 ? NaN : code === 1 ? -Infinity : code === 0xffff ? Infinity : packed.origin + code * packed.step;
  }
  return values;
}

function picture(uri) {
  return new Promise((done) => {
    if (!uri) return done(null);
    const image = new Image();
    image.onload = () => done(image);
    image.onerror = () => done(null);
    image.src = uri;
  });
}

const loaded = new Map();  // key of a scene -> data at full size, from the assets
window.depthcli = (key, data) => loaded.set(key, data);

async function sceneData(number) {
  const key = page.keys[number];
  if (page.assets[number] && !loaded.has(key)) {
    await new Promise((done) => {
      const script = make("script", "", { src: page.assets[number], onload: done, onerror: done });
      document.head.append(script);
    });
  }
  if (!loaded.has(key)) loaded.set(key, JSON.parse($(`data-${number}`).textContent));
  return loaded.get(key);
}

async function unpackView(view) {
  const runs = {};
  for (const [name, run] of Object.entries(view.runs)) {
    const [values, error, wrong, bound, status] = await Promise.all([run.values, run.error, run.wrong, run.bound, run.status].map(unpack));
    const confidence = {};
    for (const [measure, packed] of Object.entries(run.confidence)) {
      confidence[measure] = { values: await unpack(packed), shown: packed.shown };
    }
    runs[name] = { values, error, wrong, bound, status, confidence };
  }
  const [image, sensor, truth, region] = await Promise.all([picture(view.image), ...[view.sensor, view.truth, view.region].map(unpack)]);
  return { ...view, image, sensor, truth, region, runs };
}
