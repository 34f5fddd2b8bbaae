"use strict";
// Draws the plots of a sweep's report from the JSON in the page. Text is never interpreted as HTML.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const byId = (id) => document.getElementById(id);
  const short = (v) => (v === null ? "" : String(+v.toPrecision(3)));
  const called = (key, v) => (data.labels[key] ? fit(data.labels[key][Math.round(v)] ?? "", 20) : key in data.margins && v === -1 ? "≤ -1" : short(v));
  // Names may be of any length; what distinguishes them is often at their end.
  const fit = (name, most) => (name.length > most ? `${name.slice(0, most - 9)}…${name.slice(-8)}` : name);
  function named(parent, attributes, name, most) {
    const made = svg(parent, "text", { class: "name", ...attributes }, fit(name, most));
    if (name.length > most) tip(made, name);
  }
  const ends = (values) => {
    const known = values.filter((v) => v !== null);
    const low = Math.min(...known), high = Math.max(...known);
    return high > low ? [low, high] : [low - 0.5, high + 0.5];
  };

  function svg(parent, name, attributes, text) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    parent.append(made);
    return made;
  }
  const tip = (node, text) => svg(node, "title", {}, text);

  function options(select, names, changed) {
    for (const name of names) {
      const made = document.createElement("option");
      [made.textContent, made.value] = [fit(name, 80), name];
      select.append(made);
    }
    select.addEventListener("change", changed);
  }

  // Margins by value: points above, share of failures below.
  const W = 360, H = 250, LEFT = 38, RIGHT = 8, TOP = 24, SPLIT = 168, BARS = 184, BOTTOM = 228;
  function scatter(key, margin) {
    const plot = svg(byId("scatter"), "svg", { viewBox: `0 0 ${W} ${H}`, "data-key": key });
    const xs = data.points[key], ys = data.points[margin], part = data.marginals[key];
    const [low, high] = [part.starts[0], part.ends[part.ends.length - 1]];
    const x = (v) => LEFT + ((v - low) / (high - low)) * (W - LEFT - RIGHT);
    const [bottom, top] = ends([...ys, 0]);
    const y = (v) => SPLIT - ((v - bottom) / (top - bottom)) * (SPLIT - TOP);
    named(plot, { x: LEFT, y: 14 }, key, 44);
    svg(plot, "line", { x1: LEFT, x2: W - RIGHT, y1: y(0), y2: y(0), stroke: "var(--quiet)", "stroke-dasharray": "3 3" });
    for (const v of [bottom, 0, top]) {
      if (v === 0 || Math.abs(y(v) - y(0)) > 12) svg(plot, "text", { x: LEFT - 5, y: y(v) + 4, "text-anchor": "end" }, called(margin, v));
    }
    const dots = { 0: "", 1: "" }, dot = xs.length > 500 ? 3.2 : xs.length > 50 ? 5 : 8;
    xs.forEach((v, i) => {
      if (ys[i] !== null) dots[data.bad[i]] += `M${x(v).toFixed(1)} ${y(ys[i]).toFixed(1)}h0`;
    });
    for (const [bad, name] of [[0, "--good"], [1, "--bad"]]) {
      svg(plot, "path", { d: dots[bad], stroke: `var(${name})`, "stroke-width": dot, "stroke-linecap": "round", opacity: 0.6 });
    }
    const shares = part.rows.map((rows, i) => (rows ? part.bad[i] / rows : 0));
    const full = Math.max(...shares, ...part.bounds.filter((_, i) => part.rows[i]).map((b) => b[1]), 0.01);
    const h = (share) => BOTTOM - (share / full) * (BOTTOM - BARS);
    part.rows.forEach((rows, i) => {
      if (!rows) return;
      const [a, b] = [x(part.starts[i]), x(part.ends[i])], middle = (a + b) / 2;
      const bar = svg(plot, "rect", { x: a + 0.5, y: h(shares[i]), width: Math.max(b - a - 1, 1), height: BOTTOM - h(shares[i]), fill: "var(--bad)", opacity: 0.75 });
      tip(bar, `${part.names[i]}: ${part.bad[i]} of ${rows} without success`);
      if (part.bounds.length) svg(plot, "line", { x1: middle, x2: middle, y1: h(part.bounds[i][0]), y2: h(part.bounds[i][1]), stroke: "var(--quiet)" });
    });
    svg(plot, "line", { x1: LEFT, x2: W - RIGHT, y1: BOTTOM, y2: BOTTOM, stroke: "var(--line)" });
    svg(plot, "text", { x: LEFT - 5, y: BARS + 6, "text-anchor": "end" }, `${short(100 * full)} %`);
    const middles = part.starts.map((start, i) => x((start + part.ends[i]) / 2));
    spread(part.ticks, middles, length(part.ticks) + 6, (name, middle) => svg(plot, "text", { x: middle, y: H - 8, "text-anchor": "middle" }, name));
  }

  // Writes names at the middles of their bars or cells, as many as fit beside each other.
  function spread(names, middles, room, write) {
    let end = -Infinity;
    names.forEach((name, i) => {
      if (!name || middles[i] - room / 2 < end) return;
      end = middles[i] + room / 2;
      write(fit(name, 20), middles[i]);
    });
  }
  const length = (names) => 6.5 * Math.max(...names.map((name) => Math.min(name.length, 20)));

  function influence(margin) {
    if (!data.influences) return;
    const found = data.influences[margin] ?? [], step = 26;
    const width = Math.min(Math.max(byId("influence").clientWidth, 240), 860); // no scaling, so that text has its usual size
    const name = Math.min(230, 0.48 * width);
    byId("influence").replaceChildren();
    if (!found.length) { byId("influence").textContent = data.total < 10 ? `Too few rows: ${data.total}, where 10 are needed.` : "This margin does not vary, or too few rows have it."; return; }
    const plot = svg(byId("influence"), "svg", { viewBox: `0 0 ${width} ${found.length * step + 22}`, style: `max-width: ${width}px` });
    const low = Math.min(0, ...found.map((f) => f[2] ?? f[1])), high = Math.max(0.1, ...found.map((f) => f[3] ?? f[1]));
    const x = (v) => name + ((v - low) / (high - low)) * (width - name - 60);
    found.forEach(([key, value, from, to], i) => {
      const y = i * step + 12;
      named(plot, { x: name - 10, y: y + 4, "text-anchor": "end" }, key, Math.floor(name / 7.6));
      svg(plot, "rect", { x: Math.min(x(0), x(value)), y: y - 7, width: Math.abs(x(value) - x(0)), height: 14, fill: value < 0 ? "var(--bad)" : "var(--good)", opacity: 0.8 });
      if (from !== null) svg(plot, "line", { x1: x(from), x2: x(to), y1: y, y2: y, stroke: "var(--text)", "stroke-width": 1.5 });
      svg(plot, "text", { x: x(Math.max(to ?? 0, value, 0)) + 8, y: y + 4 }, value.toFixed(2) + (data.labels[key] ? " (words)" : ""));
    });
    svg(plot, "line", { x1: x(0), x2: x(0), y1: 0, y2: found.length * step, stroke: "var(--line)" });
  }

  function map() {
    const at = byId("pair").selectedIndex, box = byId("map");
    box.replaceChildren();
    if (at < 0) { box.textContent = "Only one value is varied."; return; }
    const { keys, names: [xs, ys], ticks: [below, beside], rows, bad } = data.maps[at];
    const [nx, ny] = [xs.length, ys.length], size = Math.max(Math.round(364 / Math.max(nx, ny)), 6), left = 34 + length(beside), bottom = ny * size + 6;
    const width = Math.max(left + nx * size + 20, 260); // no scaling, so that text has its usual size
    const plot = svg(box, "svg", { viewBox: `0 0 ${width} ${bottom + 44}`, style: `max-width: ${width}px` });
    const most = Math.max(...bad.map((b, i) => (rows[i] ? b / rows[i] : 0)), 0.01);
    for (let i = 0; i < nx; i++) for (let j = 0; j < ny; j++) {
      const count = rows[i * ny + j], failing = bad[i * ny + j];
      const cell = svg(plot, "rect", { x: left + i * size, y: (ny - 1 - j) * size + 6, width: size - 1, height: size - 1, rx: 2,
        fill: !count ? "none" : failing ? "var(--bad)" : "var(--soft)", opacity: failing ? 0.15 + (0.85 * failing) / count / most : 1 });
      if (count) tip(cell, `${keys[0]} ${xs[i]}, ${keys[1]} ${ys[j]}: ${failing} of ${count} without success`);
    }
    spread(below, below.map((_, i) => left + (i + 0.5) * size), length(below) + 6, (name, x) => svg(plot, "text", { x, y: bottom + 16, "text-anchor": "middle" }, name));
    spread([...beside].reverse(), beside.map((_, j) => (j + 0.5) * size + 10), 14, (name, y) => svg(plot, "text", { x: left - 6, y, "text-anchor": "end" }, name));
    named(plot, { x: left + (nx * size) / 2, y: bottom + 32, "text-anchor": "middle" }, keys[0], 44);
    const middle = (ny * size) / 2;
    named(plot, { x: 14, y: middle, "text-anchor": "middle", transform: `rotate(-90 14 ${middle})` }, keys[1], 44);
  }

  // Parallel coordinates. `chosen` has the selected range of each axis, as shares of its height.
  const chosen = new Map();
  function parallel(margin) {
    const axes = [...data.keys, margin], canvas = byId("parallel"), height = 368, top = 42, bottom = 338;
    const width = Math.max(canvas.parentElement.clientWidth, 110 * axes.length);
    const scale = window.devicePixelRatio || 1;
    canvas.width = width * scale; canvas.height = height * scale;
    canvas.style.width = `${width}px`; canvas.style.height = `${height}px`;
    const draw = canvas.getContext("2d");
    draw.scale(scale, scale);
    const x = (i) => 70 + (i * (width - 140)) / Math.max(axes.length - 1, 1);
    const spans = axes.map((name) => ends(data.points[name]));
    const share = (i, v) => (v - spans[i][0]) / (spans[i][1] - spans[i][0]);
    const y = (s) => bottom - s * (bottom - top);
    const inside = (row) => axes.every((name, i) => {
      const span = chosen.get(name), v = data.points[name][row];
      return !span || (v !== null && share(i, v) >= span[0] && share(i, v) <= span[1]);
    });
    const kept = data.bad.map((_, row) => inside(row));
    const styles = { quiet: colour("--line"), good: colour("--good"), bad: colour("--bad"), text: colour("--text") };
    const line = (row) => {
      draw.beginPath();
      axes.forEach((name, i) => {
        const v = data.points[name][row];
        if (v !== null) draw.lineTo(x(i), y(share(i, v)));
      });
      draw.stroke();
    };
    const pass = (style, alpha, test) => {
      draw.strokeStyle = style; draw.globalAlpha = alpha;
      data.bad.forEach((_, row) => { if (test(row)) line(row); });
      draw.globalAlpha = 1;
    };
    const dense = Math.min(1, 120 / data.bad.length + 0.12);
    if (chosen.size) pass(styles.quiet, dense, (row) => !kept[row]);
    pass(styles.good, dense, (row) => kept[row] && !data.bad[row]);
    pass(styles.bad, Math.min(1, dense * 2), (row) => kept[row] && data.bad[row]);
    draw.font = "12px system-ui, sans-serif"; draw.textAlign = "center";
    axes.forEach((name, i) => {
      draw.strokeStyle = styles.text; draw.lineWidth = 1;
      draw.beginPath(); draw.moveTo(x(i), top); draw.lineTo(x(i), bottom); draw.stroke();
      draw.fillStyle = styles.text;
      draw.fillText(fit(name.replace(/^(plant|controller)\./, ""), 24), x(i), i % 2 ? 28 : 13);
      draw.fillText(called(name, spans[i][1]), x(i) + 22, top + 4);
      draw.fillText(called(name, spans[i][0]), x(i), bottom + 16);
      const span = chosen.get(name);
      if (span) { draw.fillStyle = styles.text; draw.globalAlpha = 0.25; draw.fillRect(x(i) - 8, y(span[1]), 16, y(span[0]) - y(span[1])); draw.globalAlpha = 1; }
    });
    const count = kept.filter(Boolean).length, failing = kept.filter((k, row) => k && data.bad[row]).length;
    byId("brushed").textContent = chosen.size ? `${count} of ${kept.length} drawn rows selected, ${failing} of them without success.` : "";
    canvas.near = (px) => axes.map((name, i) => [Math.abs(px - x(i)), name]).sort((a, b) => a[0] - b[0])[0];
    canvas.share = (py) => Math.min(Math.max((bottom - py) / (bottom - top), 0), 1);
  }

  function brush() {
    const canvas = byId("parallel");
    let axis = null, from = 0;
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("pointerdown", (event) => {
      const [px, py] = place(event), [distance, name] = canvas.near(px);
      if (distance > 30) return;
      axis = name; from = canvas.share(py);
      canvas.setPointerCapture(event.pointerId);
      event.preventDefault();
    });
    canvas.addEventListener("pointermove", (event) => {
      if (axis === null) return;
      const to = canvas.share(place(event)[1]);
      chosen.set(axis, [Math.min(from, to), Math.max(from, to)]);
      parallel(byId("margin").value);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (axis === null) return;
      if (Math.abs(canvas.share(place(event)[1]) - from) < 0.01) chosen.delete(axis);
      axis = null;
      parallel(byId("margin").value);
    });
  }

  function search() {
    if (!data.search) return;
    byId("search-section").hidden = false;
    const { index, margin, best, name } = data.search, width = 900, height = 240, left = 46;
    const plot = svg(byId("search"), "svg", { viewBox: `0 0 ${width} ${height}` });
    const [low, high] = ends([...margin, 0]), last = Math.max(index[index.length - 1], 1);
    const x = (v) => left + (v / last) * (width - left - 10);
    const y = (v) => height - 24 - ((v - low) / (high - low)) * (height - 44);
    svg(plot, "line", { x1: left, x2: width - 10, y1: y(0), y2: y(0), stroke: "var(--quiet)", "stroke-dasharray": "3 3" });
    margin.forEach((v, i) => svg(plot, "circle", { cx: x(index[i]), cy: y(v), r: 2.6, fill: v < 0 ? "var(--bad)" : "var(--good)", opacity: 0.7 }));
    svg(plot, "path", { d: best.map((v, i) => `${i ? "L" : "M"}${x(index[i])} ${y(v)}`).join(""), fill: "none", stroke: "var(--text)", "stroke-width": 1.5 });
    for (const v of [low, 0, high]) svg(plot, "text", { x: left - 6, y: y(v) + 4, "text-anchor": "end" }, short(v));
    named(plot, { x: left, y: 12 }, `${fit(name, 40)} by row; line: best so far`, 80);
    svg(plot, "text", { x: width - 10, y: height - 6, "text-anchor": "end" }, `row ${index[index.length - 1]}`);
  }

  async function copy(button) {
    const text = button.dataset.copy;
    try { await navigator.clipboard.writeText(text); }
    catch {
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    const label = button.textContent;
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = label; }, 1200);
  }

  function draw() {
    const margin = byId("margin").value;
    byId("meaning").textContent = data.margins[margin] ?? "";
    byId("scatter").replaceChildren();
    for (const key of data.keys) scatter(key, margin);
    influence(margin);
    parallel(margin);
  }

  options(byId("margin"), Object.keys(data.margins), draw);
  options(byId("pair"), data.maps.map((each) => each.keys.join(" and ")), map);
  brush();
  draw();
  map();
  search();
  document.querySelectorAll("[data-copy]").forEach((b) => b.addEventListener("click", () => copy(b)));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  window.addEventListener("resize", () => {
    influence(byId("margin").value);
    parallel(byId("margin").value);
  });
  window.sweepReport = { data, chosen };
})();
