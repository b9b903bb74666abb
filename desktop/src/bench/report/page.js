"use strict";
const R = JSON.parse(document.getElementById("report").textContent);
const P = JSON.parse(document.getElementById("pictures").textContent);
const $ = (id) => document.getElementById(id);
const escape = (t) => String(t).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
const digits = (v, n = 3) => v === null || v === undefined || !isFinite(v) ? "–"
  : v === 0 ? "0" : Math.abs(v) >= 1e6 ? (v / 1e6).toPrecision(n) + " M"
  : Math.abs(v) >= 10 ** n ? Math.round(v).toLocaleString("en") : Number(v.toPrecision(n)).toString();
const bytes = (v) => v >= 1e9 ? digits(v / 1e9) + " GB" : v >= 1e6 ? digits(v / 1e6) + " MB" : digits(v / 1e3) + " kB";
const ms = (o) => o.predicted.splats_ms + o.predicted.fragments_ms;
const words = (c) => c.split(" ").map((w) => w.replace("=", ": ")).join(" · ");

const ERRORS = {
  flip: ["visible error (FLIP, mean)", (o) => o.flip],
  ssim: ["structural error (1 − SSIM)", (o) => o.ssim === null ? NaN : 1 - o.ssim],
  worst: ["worst pixel (0 to 1)", (o) => o.worst],
};
const COSTS = {
  predicted: ["predicted frame of a " + R.rates.device + ", ms", ms],
  layers: ["fragments per pixel", (o) => o.layers],
  ratio: ["time here, over the default's", (o) => o.ratio ? o.ratio.median : NaN],
  off_chip: ["bytes moved, off chip", (o) => o.off_chip],
  memory: ["bytes of the scene", (o) => o.scene_bytes],
};
const LIMIT_WORDS = ["very close", "close", "rough"];
const GROUPS = [
  ["as it is by default", [], "#111827"],
  ["coarser resolution", ["resolution-scale", "upscale", "sharpen"], "#7c3aed"],
  ["early stop", ["stop-below", "batches", "composite"], "#2563eb"],
  ["polygon", ["shape", "radius", "max-radius"], "#059669"],
  ["leaving out", ["min-opacity", "min-contribution", "near", "near-fade"], "#d97706"],
  ["projection, filter", ["projection", "low-pass"], "#dc2626"],
  ["storage, format", ["precision", "sh-precision", "sh-degree", "target-format"], "#0891b2"],
  ["order", ["order", "key-bits", "sort", "sort-per-eye", "sort-interval"], "#db2777"],
  ["where expanded", ["expansion"], "#65a30d"],
  ["several together", null, "#6b7280"],
];
const group = (o) => {
  if (!o.changed.length) return GROUPS[0];
  const hit = GROUPS.filter((g) => g[1] && g[1].some((c) => o.changed.includes(c)));
  return hit.length === 1 ? hit[0] : GROUPS[GROUPS.length - 1];
};
const dark = matchMedia("(prefers-color-scheme: dark)").matches;
if (dark) GROUPS[0][2] = "#f9fafb";

const state = { scene: null, error: "flip", cost: "predicted", filter: "", shown: "default", pinned: false, sort: "flip", up: true };
const scenes = R.scenes.filter((s) => R.outcomes.some((o) => o.scene === s.scene));
const summary = () => scenes.find((s) => s.scene === state.scene);
const outcomes = () => R.outcomes.filter((o) => o.scene === state.scene);
const fits = (o) => state.filter.toLowerCase().split(/[\s,]+/).every((w) => (o.configuration + " " + group(o)[0]).includes(w));
const outcome = (name) => outcomes().find((o) => o.configuration === name);

function answers() {
  const s = summary();
  const exact = Math.max(...outcomes().filter((o) => s.front.includes(o.configuration)).map(ms));
  $("answers").innerHTML = R.limits.map((limit, i) => {
    const o = s.answers[i] && outcome(s.answers[i]);
    const head = `<h3>Cheapest that is ${LIMIT_WORDS[i]} <small>(FLIP ≤ ${limit})</small></h3>`;
    if (!o) return `<div class="card">${head}<p>No configuration that was measured is that close.</p></div>`;
    const u = 1 + o.predicted.uncertainty;
    return `<div class="card" tabindex="0" data-name="${escape(o.configuration)}">${head}<b>${digits(ms(o))} ms</b> a frame predicted
      <small>(${digits(ms(o) / u)} to ${digits(ms(o) * u)}; ${Math.round(100 * ms(o) / exact)} % of the costliest on the line)</small>
      <code>${escape(words(o.configuration))}</code></div>`;
  }).join("");
  for (const card of $("answers").querySelectorAll("[data-name]")) {
    card.onclick = () => { state.pinned = true; show(card.dataset.name); };
    card.onmouseenter = () => { if (!state.pinned) show(card.dataset.name); };
  }
}

/** A logarithmic scale over the positive values; zero stands at the low end. */
function scale(values, from, to) {
  const positive = values.filter((v) => v > 0 && isFinite(v));
  let low = Math.min(...positive), high = Math.max(...positive);
  if (!positive.length) { low = 0.1; high = 1; }
  low /= 1.25; high *= 1.25;
  const at = (v) => from + (to - from) * Math.log(Math.max(v, low) / low) / Math.log(high / low);
  const ticks = [];
  for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e++) {
    for (const m of high / low > 300 ? [1] : high / low > 12 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9]) {
      const v = m * 10 ** e;
      if (v >= low && v <= high) ticks.push(v);
    }
  }
  return { at, ticks, low, high, inside: (v) => v >= low && v <= high };
}

function chart() {
  const W = 860, H = 470, L = 64, B = 44, T = 14, E = 14;
  const [xName, x] = ERRORS[state.error], [yName, y] = COSTS[state.cost];
  const points = outcomes().filter((o) => isFinite(x(o)) && isFinite(y(o)));
  const sx = scale(points.map(x), L, W - E), sy = scale(points.map(y), H - B, T);
  const line = (x1, y1, x2, y2, c) => `<line class="${c}" x1="${x1}" y1="${y1}" x2="${x2}" y2="${y2}"/>`;
  const text = (px, py, t, a = "middle", more = "") => `<text x="${px}" y="${py}" text-anchor="${a}" ${more}>${escape(t)}</text>`;
  let svg = `<svg viewBox="0 0 ${W} ${H}" role="img" aria-label="${escape(yName)} against ${escape(xName)}">`;
  for (const t of sx.ticks) svg += line(sx.at(t), T, sx.at(t), H - B, "axis") + text(sx.at(t), H - B + 16, digits(t));
  for (const t of sy.ticks) svg += line(L, sy.at(t), W - E, sy.at(t), "axis") + text(L - 6, sy.at(t) + 4, digits(t), "end");
  svg += text((L + W) / 2, H - 8, xName + " →") + text(14, (H - B) / 2, yName + " →", "middle", `transform="rotate(-90 14 ${(H - B) / 2})"`);
  if (state.error === "flip") R.limits.forEach((l, i) => {
    if (sx.inside(l)) svg += line(sx.at(l), T, sx.at(l), H - B, "limit") + text(sx.at(l) - 4, T + 10, LIMIT_WORDS[i], "end");
  });
  if (state.cost === "predicted") for (const hz of R.refresh_rates) {
    const t = 1000 / hz;
    if (sy.inside(t)) svg += line(L, sy.at(t), W - E, sy.at(t), "rate") + text(W - E - 4, sy.at(t) - 4, hz + " Hz", "end");
  }
  const candidates = points.filter((o) => !o.changed.includes("sort-interval"));
  const front = candidates.slice().sort((a, b) => x(a) - x(b) || y(a) - y(b)).filter(((best) => (o) => y(o) < best && ((best = y(o)), true))(Infinity));
  svg += `<polyline class="front" points="${front.map((o) => sx.at(x(o)) + "," + sy.at(y(o))).join(" ")}"/>`;
  const shownLast = points.slice().sort((a, b) => (a.configuration === state.shown) - (b.configuration === state.shown));
  for (const o of shownLast) {
    const on = front.includes(o);
    svg += `<circle cx="${sx.at(x(o))}" cy="${sy.at(y(o))}" r="${on ? 7 : 5}" fill="${group(o)[2]}" data-name="${escape(o.configuration)}"
      class="${fits(o) ? "" : "faint"} ${o.configuration === state.shown ? "on" : ""}"><title>${escape(words(o.configuration))}</title></circle>`;
  }
  const used = GROUPS.filter((g) => points.some((o) => group(o) === g));
  $("chart").innerHTML = svg + "</svg><div class=legend>" + used.map((g) => `<span><i style="background:${g[2]}"></i>${g[0]}</span>`).join("") + "</div>";
  const root = $("chart").firstElementChild;
  root.onmousemove = (e) => { if (!state.pinned) pick(e); };
  root.onclick = (e) => { state.pinned = pick(e); };
  function pick(e) {
    const box = root.getBoundingClientRect();
    const [px, py] = [(e.clientX - box.left) * W / box.width, (e.clientY - box.top) * H / box.height];
    let best = null, least = 30 ** 2;
    for (const o of points) {
      if (!fits(o)) continue;
      const d = (sx.at(x(o)) - px) ** 2 + (sy.at(y(o)) - py) ** 2;
      if (d < least) { least = d; best = o; }
    }
    if (best && best.configuration !== state.shown) show(best.configuration);
    return best !== null;
  }
}

function thumb(key, title) {
  return P[key] ? `<div><img alt="${escape(title)}" src="${P[key]}"><span>${escape(title)}</span></div>` : "";
}

function detail() {
  const o = outcome(state.shown) || outcomes()[0];
  if (!o) return;
  const key = o.scene + "|" + o.configuration;
  const u = 1 + o.predicted.uncertainty;
  const rows = [
    ["FLIP mean, weighted median", digits(o.flip) + ", " + digits(o.flip_median)],
    ["PSNR, SSIM", (o.psnr === null ? "∞" : digits(o.psnr) + " dB") + ", " + (o.ssim === null ? "–" : digits(o.ssim, 5))],
    ["fragments per pixel", digits(o.layers)],
    ["predicted frame, " + R.rates.device, `${digits(ms(o))} ms (${digits(ms(o) / u)} to ${digits(ms(o) * u)})`],
    ["time here, over the default's", o.ratio ? `${digits(o.ratio.median)} (${digits(o.ratio.low)} to ${digits(o.ratio.high)})` : "–"],
    ["scene on the device", bytes(o.scene_bytes)],
  ];
  $("detail").innerHTML = `<h3>${escape(words(o.configuration))}</h3>` +
    (o.no_effect ? "<p>This choice changes nothing on this scene.</p>" : "") +
    `<div class="thumbs">${thumb(o.scene + "|truth", "what it should be")}${thumb(key, "as it was drawn")}${thumb(key + "|error", "visible error (FLIP)")}${P[key + "|layers"] ? thumb(key + "|layers", "layers of splats (0 to 200)") : thumb(o.scene + "|layers", "layers of the reference (0 to 200)")}</div>` +
    (P[key] ? "" : "<p class=soft>Its picture is in the folder <code>pictures</code> beside this page.</p>") +
    `<table>${rows.map(([k, v]) => `<tr><td>${escape(k)}</td><td class="num">${escape(v)}</td></tr>`).join("")}</table>
    <p class="soft">${state.pinned ? "Click on empty ground to let go." : "Point at a dot; click to keep it."}</p>`;
}

function show(name) { state.shown = name; chart(); detail(); }

function sceneTable() {
  const head = ["scene", "splats", "layers per pixel, mean", "most", "of them hidden", ...R.refresh_rates.map((h) => `layers affordable at ${h} Hz`), "measured against"];
  const rows = scenes.map((s) => {
    const t = s.truths.filter((t) => t.layers);
    const mean = (f) => t.length ? t.reduce((a, t) => a + f(t), 0) / t.length : NaN;
    const budget = (b) => b > 0 ? digits(b) : `<span class="over">none: its splats alone take longer</span>`;
    return `<tr><td>${escape(s.scene)}</td><td>${s.splats.toLocaleString("en")}</td><td>${digits(mean((t) => t.layers[0]))}</td>
      <td>${t.length ? Math.max(...t.map((t) => t.layers[1])) : "–"}</td><td>${digits(mean((t) => t.hidden || 0))}</td>
      ${s.budgets.map((b) => `<td>${budget(b)}</td>`).join("")}<td class="text">${escape(s.truths.map((t) => t.what)[0] || "")}</td></tr>`;
  });
  const maps = scenes.map((s) => thumb(s.scene + "|layers", s.scene)).join("");
  $("scenes").innerHTML = `<p>Layers are splats blended over one pixel; hidden ones lie behind so much that less than 1/255 of
    their light arrives. What is affordable follows from the predicted rates: two eyes of ${R.rates.eye[0]} × ${R.rates.eye[1]}
    pixels, all splats projected for both.</p><div class="scroll"><table><tr>${head.map((h) => `<th>${h}</th>`).join("")}</tr>${rows.join("")}</table></div>
    <div class="thumbs" style="grid-template-columns:repeat(auto-fill,minmax(200px,1fr))">${maps}</div>`;
}

const COLUMNS = [
  ["configuration", "configuration", (o) => o.configuration],
  ["FLIP", "flip", (o) => o.flip], ["PSNR, dB", "psnr", (o) => o.psnr ?? Infinity], ["SSIM", "ssim", (o) => o.ssim],
  ["worst pixel", "worst", (o) => o.worst],
  ["predicted, ms", "predicted", ms], ["fragments per pixel", "layers", (o) => o.layers],
  ["primitives", "primitives", (o) => o.primitives], ["vertices", "vertices", (o) => o.vertices],
  ["draw calls", "draws", (o) => o.draws],
  ["time here / default", "ratio", (o) => o.ratio ? o.ratio.median : NaN],
  ["device ms (quartiles)", "device", (o) => o.device_ms.median],
  ["prepare ms", "prepare", (o) => o.passes_ms[1]], ["draw ms", "draw", (o) => o.passes_ms[2]],
  ["sort ms", "sort", (o) => o.sort_ms ? o.sort_ms.median : NaN],
  ["moved off chip", "off", (o) => o.off_chip], ["scene", "bytes", (o) => o.scene_bytes], ["device memory", "memory", (o) => o.memory],
];

function table() {
  const column = COLUMNS.find((c) => c[1] === state.sort);
  const value = column[2];
  const order = (a, b) => { const [x, y] = [value(a), value(b)]; return (x < y ? -1 : x > y ? 1 : 0) * (state.up ? 1 : -1); };
  const s = summary();
  const cell = (o, c) => {
    if (c[1] === "configuration") return `<td><code>${escape(words(o.configuration))}</code>${o.no_effect ? " <small>no effect here</small>" : ""}</td>`;
    if (c[1] === "device") return `<td class=num>${digits(o.device_ms.median)} <small>${digits(o.device_ms.low)}–${digits(o.device_ms.high)}</small></td>`;
    if (["off", "bytes", "memory"].includes(c[1])) return `<td class=num>${bytes(c[2](o))}</td>`;
    if (c[1] === "psnr") return `<td class=num>${o.psnr === null ? "∞" : digits(o.psnr, 4)}</td>`;
    return `<td class=num>${digits(c[2](o), c[1] === "ssim" ? 5 : 3)}</td>`;
  };
  const rows = outcomes().filter(fits).sort(order).map((o) =>
    `<tr class="${s.front.includes(o.configuration) ? "front" : ""}" data-name="${escape(o.configuration)}">${COLUMNS.map((c) => cell(o, c)).join("")}</tr>`);
  const refused = R.refusals.filter((r) => r.scene === state.scene).map((r) =>
    `<tr class="off"><td><code>${escape(words(r.configuration))}</code></td><td class="text" colspan="${COLUMNS.length - 1}">cannot run: ${escape(r.reason)}</td></tr>`);
  $("table").innerHTML = `<table><tr>${COLUMNS.map((c) => `<th data-key="${c[1]}">${c[0]}${c[1] === state.sort ? (state.up ? " ▲" : " ▼") : ""}</th>`).join("")}</tr>${rows.join("")}${refused.join("")}</table>`;
  $("tablenote").innerHTML = `Counts are the headline: they are the same on every machine. Times are from this machine, as medians over
    ${Math.max(...outcomes().map((o) => o.device_ms.count))} rounds; only their ratios within a round say anything. A coloured edge marks the line of the chart. Click on a heading to sort.`;
  for (const th of $("table").querySelectorAll("th")) th.onclick = () => {
    if (state.sort === th.dataset.key) state.up = !state.up; else { state.sort = th.dataset.key; state.up = true; }
    table();
  };
}

/** A square of values in viridis-like colours, logarithmic. */
function surface() {
  const S = R.surface, n = S.values.length, size = 260, step = size / n;
  const low = Math.log(S.optimal), high = Math.log(Math.max(...S.values.flat()));
  const stops = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  const colour = (v) => {
    const t = Math.min(Math.max((Math.log(v) - low) / (high - low), 0), 1) * (stops.length - 1), i = Math.min(Math.floor(t), stops.length - 2);
    return `rgb(${stops[i].map((c, k) => Math.round(c + (stops[i + 1][k] - c) * (t - i))).join(",")})`;
  };
  let svg = `<svg viewBox="0 0 ${size} ${size + 24}" style="width:260px">`;
  S.values.forEach((row, i) => row.forEach((v, j) => {
    svg += `<rect x="${j * step}" y="${i * step}" width="${step + .3}" height="${step + .3}" fill="${colour(v)}"><title>ε = ${digits(v)}</title></rect>`;
  }));
  const degrees = Math.round(S.limit * 180 / Math.PI * 10) / 10;
  svg += `<text x="0" y="${size + 16}">φ from −${degrees}° to ${degrees}°, θ downwards</text></svg>`;
  const rows = S.expectations.map(([name, classic, optimal]) =>
    `<tr><td>${escape(name)}</td><td>${digits(classic)}</td><td>${digits(optimal)}</td><td>${digits(classic / optimal)}</td></tr>`);
  return `<div class="row"><div>${svg}<p class="soft">ε(θ, φ) of equation 16 over the domain of figure 2b, logarithmic:<br>
    ${digits(S.optimal, 4)} in the middle, ${digits(Math.max(...S.values.flat()), 4)} in the corners.</p></div>
    <div><p>Expectation of ε over a view's pixels (region of ${digits(S.half * 180 / Math.PI)}° around each mean, three standard deviations of a splat of 1°):</p>
    <table><tr><th>field of view</th><th>classic</th><th>optimal</th><th>ratio</th></tr>${rows.join("")}</table></div></div>`;
}

function rings(page) {
  if (!page.rings.length) return "";
  const longest = Math.max(...page.rings.map((r) => r[2].length));
  const head = Array.from({ length: longest }, (_, i) => `<th>${10 * i}–${10 * i + 10}°</th>`).join("");
  const rows = page.rings.map(([scene, name, values]) =>
    `<tr><td>${escape(scene)}</td><td class="text"><code>${escape(words(name))}</code></td>${Array.from({ length: longest }, (_, i) => `<td>${values[i] >= 0 ? digits(values[i]) : "–"}</td>`).join("")}</tr>`);
  return `<p>Mean FLIP by angle from the middle of the view:</p><div class="scroll"><table><tr><th>scene</th><th class="text">configuration</th>${head}</tr>${rows.join("")}</table></div>`;
}

function experiments() {
  $("experiments").innerHTML = R.experiments.map((e) => {
    const some = e.rows.some((r) => r.ours.some((o) => o.value !== null));
    const head = `<tr><th>figure</th><th class="text">published</th>${e.scenes.map((s) => `<th>${escape(s)}</th>`).join("")}</tr>`;
    const rows = e.rows.map((r) => `<tr><td>${escape(r.what)}</td><td class="text">${escape(r.published || "–")}</td>${r.ours.map((o) => `<td class=num style="white-space:normal">${escape(o.text)}</td>`).join("")}</tr>`);
    const body = some ? `<div class="scroll"><table>${head}${rows.join("")}</table></div>` : `<p class="soft">Not measured in this run: <code>motes bench --sweep ${e.name}</code>.</p>`;
    return `<div class="page" id="${e.name}"><h3>${escape(e.title)} <small><code>--sweep ${e.name}</code>${e.source ? " · " + escape(e.source) : ""}</small></h3>
      <p>${escape(e.question)}</p>${body}${e.name === "projection" ? rings(e) + surface() : ""}<p><b>Why they differ.</b> ${escape(e.why)}</p></div>`;
  }).join("");
}

function method() {
  const machines = R.machines.map((m) => `<tr><td>${escape(m.date)}</td><td class="text">${escape(m.device)}${m.software ? " (on the processor)" : ""}</td><td class="text">${escape(m.driver)}, Vulkan ${escape(m.api)}</td>
    <td class="text">${escape(m.processor)}, ${m.threads} threads, ${escape(m.system)}</td><td class="text">motes ${escape(m.version)}, commit ${escape(m.commit || "unknown")}</td></tr>`);
  const agreement = R.agreement.map((a) => `<tr><td>${escape(a.scene)}</td><td>${a.shared}</td><td>${digits(a.front)}</td><td>${digits(a.predicted)}</td><td>${digits(a.device)}</td><td>${digits(a.device_front)}</td></tr>`);
  $("method").innerHTML = `<p>Pictures were compared with a reference computed in 64-bit floating point, or with its declared stand-in (see the table of
    scenes), by FLIP at ${digits(R.pixels_per_degree)} pixels per degree, PSNR, SSIM and the worst pixel. Every configuration was drawn once to
    warm up; then all were drawn in turn, round after round, so that drift of the machine meets all of them alike.</p>
    <p><b>The frame of a ${escape(R.rates.device)} is predicted, not measured.</b> Rates: ${digits(R.rates.splats_per_second)} splats of an eye and
    ${digits(R.rates.fragments_per_second / 1000)} thousand fragments a second of pure stage time; source: ${escape(R.rates.source)}. Frames of the same source that
    the rates were not taken from are met within a factor of ${1 + R.rates.uncertainty}. Left out: the compositor's share, binning of large
    polygons, bandwidth, heat. A file of rates from a real device replaces these: <code>--rates</code>.</p>
    <div class="scroll"><table><tr><th>when</th><th class="text">device</th><th class="text">driver</th><th class="text">machine</th><th class="text">program</th></tr>${machines.join("")}</table></div>` +
    (agreement.length ? `<p>Agreement with an earlier run, as rank correlations:</p><div class="scroll"><table><tr><th>scene</th><th>shared configurations</th><th>front, predicted</th><th>all, predicted</th><th>all, time here</th><th>front, time here</th></tr>${agreement.join("")}</table></div>` : "");
}

function everything() {
  if (!outcome(state.shown)) state.shown = "default";
  answers(); chart(); detail(); table();
}

const option = (value, name) => `<option value="${escape(value)}">${escape(name)}</option>`;
$("scene").innerHTML = scenes.map((s) => option(s.scene, s.scene)).join("");
$("error").innerHTML = Object.entries(ERRORS).map(([k, v]) => option(k, v[0])).join("");
$("cost").innerHTML = Object.entries(COSTS).map(([k, v]) => option(k, v[0])).join("");
for (const key of ["scene", "error", "cost"]) $(key).onchange = () => { state[key] = $(key).value; state.pinned = false; everything(); };
$("filter").oninput = () => { state.filter = $("filter").value; chart(); table(); };
if (scenes.length) {
  state.scene = scenes[0].scene;
  state.shown = summary().answers[1] || "default";
  everything(); sceneTable();
}
experiments(); method();
