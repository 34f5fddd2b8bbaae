"use strict";
// Draws the plots of a sweep's report from the JSON in the page. Text is never interpreted as HTML.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const FAILURES = "failures"; // the share of rows without success, beside the metrics
  const count = data.index.length;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const state = { metric: "", key: data.keys[0], colour: "", pair: 0, all: false, row: null };

  // Elements and texts.

  function make(name, attributes, ...children) {
    const element = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.append(...children);
    return element;
  }
  function svg(parent, name, attributes, text) {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    parent.append(element);
    return element;
  }
  const tip = (node, text) => svg(node, "title", {}, text);
  const button = (text, act, attributes = {}) => {
    const element = make("button", { type: "button", ...attributes }, text);
    element.addEventListener("click", act);
    return element;
  };
  const copier = (what, text) => {
    const element = button(`Copy ${what}`, () => copy(element, text), { "data-copy": text, title: text, "aria-label": `Copy ${what}: ${text}` });
    return element;
  };

  /** A number in four digits; what is only rounding is 0. */
  const number = (v) => (v === null ? "none" : Math.abs(v) < 1e-7 ? "0" : String(+v.toPrecision(4)).replace("-", "−"));
  const isMargin = (name) => name.split(".")[0] === "margin";
  const unit = (name) => (isMargin(name) ? "" : data.metrics[name]?.unit ?? data.units[name] ?? "");
  const better = (name) => (isMargin(name) ? "higher" : data.metrics[name]?.better);
  const withUnit = (text, name) => (unit(name) ? `${text} ${unit(name)}` : text);
  const value = (name, v) => (v === null ? "none" : data.labels[name] ? data.labels[name][v] : withUnit(number(v), name));
  /** A metric's name without its section and unit, which are written beside it. */
  function called(name) {
    if (name === FAILURES) return "rows without success";
    const end = unit(name) && `_${unit(name)}`;
    const [, stem, index] = name.replace(/^summary\./, "").match(/^(.*?)((?:\[\d+\])?)$/s);
    return (end && stem.endsWith(end) ? stem.slice(0, -end.length) : stem) + index;
  }
  const title = (name) => (name === FAILURES ? `${called(name)} [%]` : unit(name) ? `${called(name)} [${unit(name)}]` : called(name));
  // Names may be of any length; what distinguishes them is often at their end.
  const fit = (name, most) => (name.length > most ? `${name.slice(0, most - 9)}…${name.slice(-8)}` : name);
  const wide = (texts) => 7 * Math.max(...texts.map((text) => text.length));

  const known = (values) => values.filter((v) => v !== null);
  const ends = (values) => [Math.min(...values), Math.max(...values)];
  function varies(name) {
    const [low, high] = ends(known(data.points[name]));
    return high - low > 1e-9 + 1e-6 * Math.max(Math.abs(low), Math.abs(high));
  }

  // Scales and axes.

  /** Round numbers from low to high, about `count` of them, but never one alone. */
  function steps(low, high, count) {
    const rough = (high - low) / Math.max(count, 5), power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough * 0.999);
    const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const ticks = [];
    for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) ticks.push(+v.toFixed(Math.min(places, 12)));
    return ticks;
  }

  /** A scale of values: linear or, if few are far away from the others, logarithmic on both sides of 0. */
  function scale(values, from, to, includes = []) {
    const all = known([...values, ...includes]);
    let [low, high] = all.length ? ends(all) : [0, 1];
    if (high - low < 1e-9 + 1e-6 * Math.max(Math.abs(low), Math.abs(high))) [low, high] = [low - (Math.abs(low) / 10 || 0.5), high + (Math.abs(high) / 10 || 0.5)];
    else if (low > 0 && low < high / 2) low = 0;
    const sizes = known(values).map(Math.abs).sort((a, b) => a - b), middle = sizes[sizes.length >> 1] ?? 0;
    const bent = middle > 0 && Math.max(-low, high) > 40 * middle;
    const bend = bent ? (v) => Math.asinh(v / middle) : (v) => v;
    const pad = 0.04 * (bend(high) - bend(low)), first = bend(low) - (low === 0 ? 0 : pad), last = bend(high) + pad;
    const at = (v) => from + ((bend(v) - first) / (last - first)) * (to - from);
    let ticks = steps(low, high, Math.abs(to - from) / 70);
    if (bent) {
      const powers = Array.from({ length: 13 }, (_, i) => 10 ** (Math.floor(Math.log10(middle)) + i));
      ticks = [0];
      for (const tick of powers.flatMap((p) => [p, -p])) {
        if (tick >= low && tick <= high && ticks.every((other) => Math.abs(at(other) - at(tick)) > 22)) ticks.push(tick);
      }
    }
    return { at, ticks, low, high, bent };
  }

  /** The axis of a varied key: its values at equal distances if it has few, else its range. */
  function keyAxis(key, from, to) {
    const part = data.marginals[key], parts = part.names.length;
    if (part.each) {
      const middles = part.starts.map((start, i) => (start + part.ends[i]) / 2), size = (to - from) / parts;
      const place = (v) => middles.reduce((best, m, i) => (Math.abs(m - v) < Math.abs(middles[best] - v) ? i : best), 0);
      return { each: true, parts, size: Math.abs(size), place, at: (v) => from + (place(v) + 0.5) * size, ticks: part.names.map((name, i) => [name, from + (i + 0.5) * size]) };
    }
    const [low, high] = [part.starts[0], part.ends[parts - 1]], pad = (to - from) * 0.015;
    const at = (v) => from + pad + ((v - low) / (high - low)) * (to - from - 2 * pad);
    return { each: false, parts, at, ticks: steps(low, high, Math.abs(to - from) / 110).map((v) => [number(v), at(v)]) };
  }

  function canvas(box, height, label) {
    const width = Math.max(box.clientWidth, 260); // no scaling, so that text has its usual size
    box.replaceChildren();
    const plot = svg(box, "svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": label });
    return [plot, width];
  }

  /** Write the axes around a plot: ticks below, and beside with grid lines. */
  function frame(plot, { left, right, top, bottom }, x, beside, names) {
    for (const [text, y] of beside) {
      svg(plot, "line", { x1: left, x2: right, y1: y, y2: y, class: "grid" });
      svg(plot, "text", { x: left - 8, y: y + 4, "text-anchor": "end" }, text);
    }
    let end = -Infinity;
    const most = x.each ? Math.max(Math.floor(x.size / 7), 12) : 20;
    for (const [name, place] of [...x.ticks].sort((a, b) => a[1] - b[1])) {
      const text = fit(name, most), half = 3.4 * text.length;
      if (place - half < end) continue;
      end = place + half + 8;
      const centre = Math.min(Math.max(place, half + 2), Math.max(right + 8 - half, half + 2));
      const written = svg(plot, "text", { x: centre, y: bottom + 18, "text-anchor": "middle" }, text);
      if (text !== name) tip(written, name);
      svg(plot, "line", { x1: place, x2: place, y1: bottom, y2: bottom + 4, class: "axis" });
    }
    svg(plot, "line", { x1: left, x2: right, y1: bottom, y2: bottom, class: "axis" });
    svg(plot, "text", { x: (left + right) / 2, y: bottom + 40, "text-anchor": "middle", class: "name" }, fit(names[0], Math.floor((right - left) / 7.5)));
    svg(plot, "text", { x: 2, y: 13, class: "name" }, fit(names[1], Math.floor(right / 7.5)));
  }

  // Colours.

  const MARKS = ["#2f7cf6", "#f2711c", "#12a594", "#d6409f", "#8e5cf5", "#d9a400", "#4aa3c7", "#c2473a"]; // most people can tell them apart
  const SHADES = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]; // even in lightness
  function shade(share, hues = SHADES) {
    const at = Math.min(Math.max(share, 0), 1) * (hues.length - 1), i = Math.min(Math.floor(at), hues.length - 2);
    return hues[i].map((v, c) => Math.round(v + (at - i) * (hues[i + 1][c] - v)));
  }
  const css = (rgb) => `rgb(${rgb.join(" ")})`;
  const seen = (share) => css(shade(dark.matches ? 0.25 + 0.75 * share : 0.85 * share)); // on the page's own ground
  function colours(key) {
    const part = data.marginals[key], axis = keyAxis(key, 0, 1);
    if (axis.each && data.labels[key]) return (v) => MARKS[axis.place(v) % MARKS.length];
    if (axis.each) return (v) => seen(axis.place(v) / Math.max(axis.parts - 1, 1));
    return (v) => seen((v - part.starts[0]) / (part.ends.at(-1) - part.starts[0]));
  }
  const gradient = (hues) => `linear-gradient(90deg, ${hues.map(css).join(", ")})`;

  // The metric over a key.

  const result = (row) => data.results[row];
  function rowText(row) {
    const values = data.keys.map((key) => `${key} ${value(key, data.points[key][row])}`);
    const metric = state.metric === FAILURES ? [] : [`${called(state.metric)} ${value(state.metric, data.points[state.metric][row])}`];
    return [`Row ${data.index[row]}: ${result(row)}`, ...metric, ...values].join("\n");
  }
  /** Mark a row: a disc, and a cross without success. */
  function mark(plot, row, x, y, size, fill) {
    const bad = data.bad[row], s = size * 0.9;
    if (bad && fill) svg(plot, "circle", { cx: x, cy: y, r: size, fill });
    const node = bad
      ? svg(plot, "path", { d: `M${x - s} ${y - s}l${2 * s} ${2 * s}m0 ${-2 * s}l${-2 * s} ${2 * s}`, class: "cross", "data-row": row })
      : svg(plot, "circle", { cx: x, cy: y, r: size, fill, class: "dot", "data-row": row });
    if (row === state.row) svg(plot, "circle", { cx: x, cy: y, r: size + 5, class: "chosen" });
    tip(node, rowText(row));
  }

  function chart() {
    const { metric, key } = state, box = byId("chart");
    if (metric === FAILURES) return bars(box, key);
    const values = data.points[metric], xs = data.points[key], height = window.innerWidth < 700 ? 320 : 420;
    const lost = values.filter((v) => v === null).length, numbers = known(values);
    const said = `${title(metric)} of ${count} rows over ${title(key)}: ${number(Math.min(...numbers))} to ${number(Math.max(...numbers))}; ${data.bad.filter(Boolean).length} rows without success`;
    const [plot, width] = canvas(box, height, said);
    const top = 30, bottom = height - 48, floor = bottom - (lost ? 26 : 0), usual = data.nominal[metric];
    const y = scale(values, floor, top, [isMargin(metric) ? 0 : null, usual ?? null]);
    const ticks = y.ticks.map((v) => [number(v), y.at(v)]);
    const left = 14 + wide(ticks.map(([text]) => text)), right = width - 10;
    const x = keyAxis(key, left, right);
    frame(plot, { left, right, top, bottom }, x, ticks, [title(key), title(metric) + (y.bent ? ", logarithmic away from 0" : "")]);
    if (isMargin(metric)) svg(plot, "line", { x1: left, x2: right, y1: y.at(0), y2: y.at(0), class: "bound" });
    if (usual !== undefined) {
      svg(plot, "line", { x1: left, x2: right, y1: y.at(usual), y2: y.at(usual), class: "usual" });
      svg(plot, "text", { x: right, y: y.at(usual) - 5, "text-anchor": "end" }, "unvaried");
    }
    if (lost) svg(plot, "text", { x: left - 8, y: bottom - 6, "text-anchor": "end" }, "none");
    const fill = state.colour ? colours(state.colour) : () => "var(--accent)";
    const paint = (row) => (state.colour ? fill(data.points[state.colour][row]) : fill());
    if (data.isGrid && x.each) for (const line of lines(key, values)) {
      svg(plot, "path", { d: line.map((row, i) => `${i ? "L" : "M"}${x.at(xs[row])} ${y.at(values[row])}`).join(""), class: "curve", stroke: paint(line[0]) });
    }
    const size = count > 1000 ? 2.5 : count > 200 ? 3.5 : 5, order = [...xs.keys()].sort((a, b) => data.bad[a] - data.bad[b]);
    for (const row of order) mark(plot, row, x.at(xs[row]), values[row] === null ? bottom - 10 : y.at(values[row]), size, data.bad[row] ? "" : paint(row));
    byId("hint").hidden = false;
    legend();
  }

  /** Rows that differ in a key alone, in its order: the curves of a grid. */
  function lines(key, values) {
    const groups = new Map(), others = data.keys.filter((each) => each !== key);
    for (const row of values.keys()) {
      if (values[row] === null) continue;
      const group = JSON.stringify(others.map((each) => data.points[each][row]));
      groups.set(group, [...(groups.get(group) ?? []), row]);
    }
    const xs = data.points[key];
    return groups.size > 60 ? [] : [...groups.values()].map((rows) => rows.sort((a, b) => xs[a] - xs[b]));
  }

  function legend() {
    const box = byId("legend"), key = state.colour, chips = [];
    if (key && state.metric !== FAILURES) {
      const part = data.marginals[key], paint = colours(key);
      const chosen = part.each && part.names.length <= 12 ? [...part.names.keys()] : [0, part.names.length - 1];
      for (const i of chosen) {
        const text = part.each ? part.names[i] : number(i ? part.ends[i] : part.starts[0]);
        const chip = make("i", {});
        chip.style.background = paint(part.each ? (part.starts[i] + part.ends[i]) / 2 : i ? part.ends[i] : part.starts[0]);
        chips.push(make("span", { class: "chip" }, chip, text));
      }
      chips.unshift(make("span", {}, `${title(key)}:`));
    }
    if (data.bad.some(Boolean) && state.metric !== FAILURES) chips.push(make("span", { class: "chip fails" }, "× without success"));
    box.replaceChildren(...chips);
  }

  /** The share of rows without success by value, of all rows. */
  function bars(box, key) {
    const part = data.marginals[key], height = window.innerWidth < 700 ? 320 : 420, top = 30, bottom = height - 48;
    const failing = part.bad.reduce((a, b) => a + b, 0);
    byId("hint").hidden = true;
    const [plot, width] = canvas(box, height, `Share of rows without success over ${title(key)}: ${failing} of ${data.total} rows`);
    const shares = part.rows.map((rows, i) => (rows ? (100 * part.bad[i]) / rows : 0));
    const bounds = part.bounds.map((pair) => pair.map((v) => 100 * v));
    const highest = Math.max(1, ...shares, ...bounds.filter((_, i) => part.rows[i]).map((pair) => pair[1]));
    const y = scale([0, highest], bottom, top), ticks = y.ticks.map((v) => [`${number(v)} %`, y.at(v)]);
    const left = 14 + wide(ticks.map(([text]) => text)), right = width - 10, x = keyAxis(key, left, right);
    frame(plot, { left, right, top, bottom }, x, ticks, [title(key), title(FAILURES)]);
    part.rows.forEach((rows, i) => {
      if (!rows) return;
      const [a, b] = x.each ? [x.ticks[i][1] - 0.4 * x.size, x.ticks[i][1] + 0.4 * x.size] : [x.at(part.starts[i]) + 0.5, x.at(part.ends[i]) - 0.5];
      const bar = svg(plot, "rect", { x: a, y: y.at(shares[i]), width: Math.max(b - a, 1), height: bottom - y.at(shares[i]), class: "bar" });
      tip(bar, `${part.names[i]}: ${part.bad[i]} of ${rows} without success`);
      if (bounds.length) svg(plot, "line", { x1: (a + b) / 2, x2: (a + b) / 2, y1: y.at(bounds[i][0]), y2: y.at(bounds[i][1]), class: "range" });
    });
    legend();
  }

  // Two keys and the metric.

  function map() {
    const at = data.maps[state.pair];
    byId("map-section").hidden = !at;
    if (!at) return;
    const [first, second] = at.keys, box = byId("map"), { metric } = state;
    const cells = metric === FAILURES || at.keys.every((key) => data.marginals[key].each);
    const down = at.names[1].length; // its own parts: the bars of one key are finer
    const height = cells ? Math.min(Math.max(down * 58, 200), 440) + 80 : 460, top = 30, bottom = height - 48;
    const [plot, width] = canvas(box, height, `${title(metric)} over ${title(first)} and ${title(second)}`);
    const left = 14 + Math.min(wide([...(cells ? at.ticks[1] : keyAxis(second, 0, 300).ticks.map(([text]) => text)), "00"]), 0.3 * width), right = width - 10;
    const shares = metric === FAILURES, [lowest, highest] = shares ? [0, 100] : ends(known(data.points[metric]));
    const hues = shares ? (dark.matches ? [[31, 39, 50], [255, 123, 136]] : [[232, 236, 241], [209, 41, 61]]) : SHADES;
    const paint = (v) => shade((v - lowest) / (highest - lowest || 1), hues);
    if (cells) {
      const sized = (names, from, to) => {
        const size = (to - from) / names.length;
        return { each: true, size: Math.abs(size), at: (i) => from + i * size, ticks: names.map((name, i) => [name, from + (i + 0.5) * size]).filter(([name]) => name) };
      };
      const x = sized(at.ticks[0], left, right), y = sized(at.ticks[1], bottom, top);
      frame(plot, { left, right, top, bottom }, x, y.ticks.map(([name, place]) => [fit(name, Math.floor((left - 10) / 6.5)), place]), [title(first), title(second)]);
      const sums = shares ? [] : cellMeans(at, metric);
      at.rows.forEach((rows, cell) => {
        const i = Math.floor(cell / down), j = cell % down, failing = at.bad[cell];
        const v = shares ? (rows ? (100 * failing) / rows : null) : sums[cell];
        if (!rows || v === undefined) return;
        const [cx, cy] = [x.at(i), y.at(j + 1)];
        const node = svg(plot, "rect", { x: cx + 1, y: cy + 1, width: Math.max(x.size - 2, 1), height: Math.max(y.size - 2, 1), rx: 3, fill: v === null ? "var(--soft)" : css(paint(v)) });
        if (failing && !shares) svg(plot, "rect", { x: cx + 3, y: cy + 3, width: Math.max(x.size - 6, 1), height: Math.max(y.size - 6, 1), rx: 2, class: "fails" });
        const words = v === null ? "none" : shares ? `${number(v)} %` : number(v), text = `${failing && !shares ? "× " : ""}${words}`;
        tip(node, `${first} ${at.names[0][i]}, ${second} ${at.names[1][j]}: ${shares ? "" : `mean ${called(metric)} ${withUnit(words, metric)}, `}${failing} of ${rows} rows without success`);
        const [r, g, b] = v === null ? [128, 128, 128] : paint(v);
        if (x.size > 8 * text.length && y.size > 18) svg(plot, "text", { x: cx + x.size / 2, y: cy + y.size / 2 + 4, "text-anchor": "middle", class: 0.3 * r + 0.6 * g + 0.1 * b > 125 ? "on-light" : "on-dark" }, text);
      });
    } else {
      const x = keyAxis(first, left, right), y = keyAxis(second, bottom, top);
      frame(plot, { left, right, top, bottom }, x, y.ticks, [title(first), title(second)]);
      const values = data.points[metric], size = count > 1000 ? 3 : count > 200 ? 4.5 : 7;
      for (const row of [...values.keys()].sort((a, b) => data.bad[a] - data.bad[b])) {
        mark(plot, row, x.at(data.points[first][row]), y.at(data.points[second][row]), size, values[row] === null ? "var(--soft)" : css(paint(values[row])));
      }
    }
    const strip = make("i", { class: "strip" });
    strip.style.background = gradient(hues);
    const low = shares ? "0 %" : withUnit(number(lowest), metric), high = shares ? "100 %" : withUnit(number(highest), metric);
    byId("shades").replaceChildren(make("span", {}, `${called(metric)}: ${low}`), strip, make("span", {}, high), ...(data.bad.some(Boolean) && !shares ? [make("span", { class: "fails" }, "× without success")] : []));
  }

  /** Means of a metric over the drawn rows of each cell; null where none has it, undefined without rows. */
  function cellMeans({ keys: [first, second], names, rows }, metric) {
    const down = names[1].length, x = keyAxis(first, 0, 1), y = keyAxis(second, 0, 1);
    const groups = rows.map(() => []);
    data.points[metric].forEach((v, row) => groups[x.place(data.points[first][row]) * down + y.place(data.points[second][row])].push(v));
    return groups.map((group) => {
      const numbers = known(group);
      if (!group.length) return undefined;
      return numbers.length ? numbers.reduce((a, b) => a + b, 0) / numbers.length : null;
    });
  }

  // How each value influences the metric.

  function influence() {
    const box = byId("influence");
    if (!data.influences) return;
    const each = data.influences[state.metric === FAILURES ? "margin" : state.metric] ?? [];
    if (!each.length) return box.replaceChildren(data.total < 10 ? `Too few rows: ${data.total}, where 10 are needed.` : "The metric does not vary, or too few rows have it.");
    const low = Math.min(0, ...each.map((e) => e[2] ?? e[1])), high = Math.max(0.1, ...each.map((e) => e[3] ?? e[1]));
    const at = (v) => `${(100 * (v - low)) / (high - low)}%`, long = (a, b) => `${(100 * Math.abs(b - a)) / (high - low)}%`;
    box.replaceChildren(...each.map(([key, v, from, to]) => {
      const bar = make("i", { class: v < 0 ? "less" : "more" }), range = make("i", { class: "between" });
      [bar.style.left, bar.style.width] = [at(Math.min(v, 0)), long(0, v)];
      [range.style.left, range.style.width] = [at(from ?? 0), long(from ?? 0, to ?? 0)];
      const track = make("span", { class: "track" }, bar, ...(from === null ? [] : [range]));
      const words = `${v.toFixed(2).replace("-", "−")}${data.labels[key] ? " (words)" : ""}`;
      return make("div", { class: "influence" }, button(key, () => choose({ key }), { "aria-label": `${key}: show over this value` }), track, make("b", {}, words));
    }));
  }

  // Parallel coordinates. `chosen` has the selected range of each axis, as shares of its height.

  const chosen = new Map();
  function parallel() {
    byId("parallel-section").hidden = data.keys.length < 3;
    if (data.keys.length < 3) return;
    const metric = state.metric === FAILURES ? [] : [state.metric];
    const axes = [...data.keys, ...metric], place = byId("parallel"), height = 368, top = 52, bottom = 338;
    const width = Math.max(place.parentElement.clientWidth, 110 * axes.length), ratio = window.devicePixelRatio || 1;
    place.width = width * ratio; place.height = height * ratio;
    place.style.width = `${width}px`; place.style.height = `${height}px`;
    const draw = place.getContext("2d"), ink = getComputedStyle(document.documentElement);
    draw.scale(ratio, ratio);
    const x = (i) => 80 + (i * (width - 160)) / Math.max(axes.length - 1, 1);
    const reach = axes.map((name) => ends(known(data.points[name])));
    const spans = reach.map(([a, b]) => (b > a ? [a, b] : [a - 0.5, b + 0.5]));
    const share = (i, v) => (v - spans[i][0]) / (spans[i][1] - spans[i][0]);
    const y = (s) => bottom - s * (bottom - top);
    const inside = (row) => axes.every((name, i) => {
      const span = chosen.get(name), v = data.points[name][row];
      return !span || (v !== null && share(i, v) >= span[0] && share(i, v) <= span[1]);
    });
    const kept = data.bad.map((_, row) => inside(row));
    const pass = (style, alpha, test) => {
      draw.strokeStyle = ink.getPropertyValue(style); draw.globalAlpha = alpha;
      for (const row of kept.keys()) if (test(row)) {
        draw.beginPath();
        axes.forEach((name, i) => data.points[name][row] !== null && draw.lineTo(x(i), y(share(i, data.points[name][row]))));
        draw.stroke();
      }
      draw.globalAlpha = 1;
    };
    const dense = Math.min(1, 120 / count + 0.12);
    if (chosen.size) pass("--line", dense, (row) => !kept[row]);
    pass("--accent", dense, (row) => kept[row] && !data.bad[row]);
    pass("--bad", Math.min(1, dense * 2), (row) => kept[row] && data.bad[row]);
    draw.font = "12px system-ui, sans-serif"; draw.textAlign = "center";
    draw.strokeStyle = draw.fillStyle = ink.getPropertyValue("--ink");
    axes.forEach((name, i) => {
      draw.beginPath(); draw.moveTo(x(i), top); draw.lineTo(x(i), bottom); draw.stroke();
      draw.fillText(fit(title(name).replace(/^(plant|controller)\./, ""), 26), x(i), i % 2 ? 32 : 14);
      draw.fillText(value(name, reach[i][1]), x(i), top - 3);
      if (reach[i][1] > reach[i][0]) draw.fillText(value(name, reach[i][0]), x(i), bottom + 16);
      const span = chosen.get(name);
      if (span) { draw.globalAlpha = 0.25; draw.fillRect(x(i) - 8, y(span[1]), 16, y(span[0]) - y(span[1])); draw.globalAlpha = 1; }
    });
    const failing = kept.filter((k, row) => k && data.bad[row]).length;
    byId("brushed").textContent = chosen.size ? `${kept.filter(Boolean).length} of ${kept.length} drawn rows selected, ${failing} of them without success.` : "";
    place.near = (px) => axes.map((name, i) => [Math.abs(px - x(i)), name]).sort((a, b) => a[0] - b[0])[0];
    place.share = (py) => Math.min(Math.max((bottom - py) / (bottom - top), 0), 1);
  }

  function brush() {
    const place = byId("parallel");
    let axis = null, from = 0;
    const spot = (event) => { const box = place.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    place.addEventListener("pointerdown", (event) => {
      const [px, py] = spot(event), [distance, name] = place.near(px);
      if (distance > 30) return;
      axis = name; from = place.share(py);
      place.setPointerCapture(event.pointerId);
      event.preventDefault();
    });
    place.addEventListener("pointermove", (event) => {
      if (axis === null) return;
      const to = place.share(spot(event)[1]);
      chosen.set(axis, [Math.min(from, to), Math.max(from, to)]);
      parallel();
    });
    place.addEventListener("pointerup", (event) => {
      if (axis === null) return;
      if (Math.abs(place.share(spot(event)[1]) - from) < 0.01) chosen.delete(axis);
      axis = null;
      parallel();
    });
  }

  // A search, row by row.

  /** The smallest margin up to each row, or the largest; -Infinity stands for none. */
  function bestSoFar(margin) {
    let best = null;
    return margin.map((v) => {
      const now = v ?? -Infinity;
      if (best === null || (data.search === "fail" ? now < best : now > best)) best = now;
      return Number.isFinite(best) ? best : null;
    });
  }

  function search() {
    byId("search-section").hidden = !data.search;
    if (!data.search) return;
    const { index } = data, name = data.searched, margin = data.points[name], best = bestSoFar(margin);
    const height = 280, top = 30, bottom = height - 48;
    const [plot, width] = canvas(byId("search"), height, `${called(name)} by row, and the best so far`);
    const y = scale(margin, bottom, top, [0]), ticks = y.ticks.map((v) => [number(v), y.at(v)]);
    const left = 14 + wide(ticks.map(([text]) => text)), right = width - 10, last = Math.max(index.at(-1), 1);
    const x = (v) => left + 6 + (v / last) * (right - left - 12);
    frame(plot, { left, right, top, bottom }, { ticks: steps(0, last, 8).map((v) => [String(v), x(v)]) }, ticks, ["row", `${called(name)}; line: best so far`]);
    svg(plot, "line", { x1: left, x2: right, y1: y.at(0), y2: y.at(0), class: "bound" });
    margin.forEach((v, i) => v !== null && svg(plot, "circle", { cx: x(index[i]), cy: y.at(v), r: 3, fill: v < 0 ? "var(--bad)" : "var(--accent)" }));
    const known = best.flatMap((v, i) => (v === null ? [] : [[x(index[i]), y.at(v)]]));
    svg(plot, "path", { d: known.map(([a, b], i) => `${i ? "L" : "M"}${a} ${b}`).join(""), class: "curve", stroke: "var(--ink)" });
  }

  // Rows.

  const LISTED = 20;
  const repeats = (row) => `${data.show} ${data.index[row]}`;
  function opener(row) {
    const link = data.views[data.index[row]];
    return link ? make("a", { href: link }, "Open in 3D") : copier("command", repeats(row));
  }

  /** All rows, the worst in the chosen metric first. */
  function worstFirst() {
    const name = state.metric === FAILURES ? "margin" : state.metric, values = data.points[name] ?? data.bad.map(() => 0);
    const sign = better(name) === "lower" ? -1 : 1;
    const rank = (row) => (values[row] === null ? -Infinity : sign * values[row]);
    return [...data.index.keys()].sort((a, b) => data.bad[b] - data.bad[a] || rank(a) - rank(b) || a - b);
  }

  function table() {
    const extra = [...new Set([state.metric, ...(data.bad.some(Boolean) ? ["margin"] : [])])].filter((name) => data.metrics[name] && hasValues(name));
    const names = [...extra, ...data.keys], rows = worstFirst();
    const head = ["Row", "Result", "3D", ...names.map(title), "Run"];
    const cell = (name, row) => {
      const v = data.points[name][row];
      return make("td", { class: data.labels[name] ? "" : "number", title: v ?? "" }, data.labels[name] ? value(name, v) : number(v));
    };
    const body = rows.slice(0, state.all ? rows.length : LISTED).map((row) => {
      const pick = button(String(data.index[row]), () => choose({ row }), { "aria-label": `Row ${data.index[row]}: show in the plots` });
      const error = data.errors[row] ? [": ", make("span", { class: "quiet", title: data.errors[row] }, data.errors[row].slice(0, 80))] : [];
      return make("tr", { class: row === state.row ? "chosen" : "" }, make("td", {}, pick), make("td", { class: data.bad[row] ? "bad" : "" }, result(row), ...error),
        make("td", {}, opener(row)), ...names.map((name) => cell(name, row)), make("td", {}, copier("command", data.commands[row])));
    });
    byId("worst").replaceChildren(make("thead", {}, make("tr", {}, ...head.map((text) => make("th", { scope: "col" }, text)))), make("tbody", {}, ...body));
    byId("more").hidden = rows.length <= LISTED;
    byId("more").textContent = state.all ? `Show ${LISTED} rows` : `Show all ${rows.length} rows`;
  }

  /** What is known about the chosen row, and how to see it. */
  function details() {
    const { row } = state, box = byId("details");
    box.hidden = row === null;
    if (row === null) return;
    const facts = rowText(row).split("\n").slice(1).join(" · ");
    const line = (words, text) => make("p", {}, `${words}: `, make("code", {}, text), " ", copier("command", text));
    box.replaceChildren(
      make("b", {}, `Row ${data.index[row]}: ${result(row)}`),
      make("p", {}, facts, data.errors[row] ? ` · ${data.errors[row]}` : ""),
      data.views[data.index[row]] ? make("p", {}, opener(row)) : line("To see it in 3D", repeats(row)),
      line("To run it again", data.commands[row]),
    );
  }

  async function copy(element, text) {
    try { await navigator.clipboard.writeText(text); }
    catch {
      const area = make("textarea", {});
      area.value = text;
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    const label = element.textContent;
    element.textContent = "Copied";
    setTimeout(() => { element.textContent = label; }, 1200);
  }

  // What is chosen.

  function options(select, groups, chosenName) {
    for (const [group, names] of groups) {
      const into = group ? select.appendChild(make("optgroup", { label: group })) : select;
      for (const [name, text] of names) into.append(make("option", { value: name }, fit(text, 80)));
    }
    select.value = chosenName;
  }
  const SAME = "same in all rows";
  const hasValues = (name) => data.points[name]?.some((v) => v !== null);

  function metrics() {
    const groups = new Map(), failures = data.bad.some(Boolean);
    const add = (group, name, text) => groups.set(group, [...(groups.get(group) ?? []), [name, text]]);
    if (failures) add("verdict", FAILURES, title(FAILURES));
    for (const name of Object.keys(data.metrics)) {
      const margin = isMargin(name);
      if (!hasValues(name) || (margin && !varies(name))) continue;
      const group = name === "margin" ? "verdict" : margin ? "margins" : name.startsWith("event.") ? "events" : called(name).split(".")[0];
      add(varies(name) ? group : SAME, name, title(name));
    }
    const same = groups.get(SAME);
    if (same) groups.delete(SAME), groups.set(SAME, same); // the last
    const all = [...groups.values()].flat().map(([name]) => name);
    const first = failures ? all.find((name) => name === "margin") ?? FAILURES : all.find((name) => !isMargin(name) && better(name) && varies(name)) ?? all[0];
    state.metric = first ?? "margin";
    options(byId("metric"), groups, state.metric);
  }

  function choose(changes) {
    Object.assign(state, changes);
    byId("key").value = state.key;
    if (state.colour === state.key) state.colour = "";
    byId("colour").value = state.colour;
    draw();
  }

  function draw() {
    byId("meaning").textContent = meaning(state.metric);
    if (state.metric === FAILURES || hasValues(state.metric)) {
      chart();
      map();
      table();
    }
    influence();
    parallel();
    search();
    details();
  }

  function meaning(name) {
    const { what } = data.metrics[name] ?? {};
    if (isMargin(name)) return `${name === "margin" ? what : `margin of ${name.slice(7)}${what && `: ${what}`}`}. Not given if the run did not finish, or a criterion could not be measured.`;
    return what ?? "Rows without success, as a share of all rows with that value or within that range; with bounds of 95 % confidence if the rows are random samples.";
  }

  metrics();
  const keyed = data.keys.map((key) => [key, title(key)]);
  options(byId("key"), [["", keyed]], state.key);
  if (data.isGrid) state.colour = data.keys[1] ?? "";
  options(byId("colour"), [["", [["", "nothing"], ...keyed]]], state.colour);
  options(byId("pair"), [["", data.maps.map((each, i) => [String(i), each.keys.map(title).join(" and ")])]], "0");
  byId("metric").addEventListener("change", (event) => choose({ metric: event.target.value }));
  byId("key").addEventListener("change", (event) => choose({ key: event.target.value }));
  byId("colour").addEventListener("change", (event) => choose({ colour: event.target.value }));
  byId("pair").addEventListener("change", (event) => choose({ pair: Number(event.target.value) }));
  byId("more").addEventListener("click", () => choose({ all: !state.all }));
  for (const id of ["chart", "map"]) byId(id).addEventListener("click", (event) => {
    const row = event.target.closest("[data-row]")?.dataset.row;
    if (row !== undefined) choose({ row: Number(row) });
  });
  brush();
  draw();
  dark.addEventListener("change", draw);
  let waiting = 0;
  window.addEventListener("resize", () => { waiting ||= requestAnimationFrame(() => { waiting = 0; draw(); }); });
  window.sweepReport = { data, chosen, state, bestSoFar };
})();
