// The page and the widget: times are moved by hand, and the error follows.
//
// All texts reach the page as text, never as markup. `connection` has start({open, message, lost})
// and send(message); messages are those of pfdist.plugins.explorer.session.reply. A measurement is a number
// m = t * S + sensor, as everywhere in the program.

const LEFT = 46, RIGHT = 14, CHART = 230, LANE = 24, HEAD = 18, ROW = LANE + HEAD; // pixels
const REST = 300, SLOW = 1000, QUIET = 900, AGAIN = 1000; // milliseconds
const JUDGE = "Judge on fresh draws";

function filled(element, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}
const make = (tag, attributes = {}, ...children) =>
  filled(document.createElement(tag), attributes, children);
const draw = (tag, attributes = {}, ...children) =>
  filled(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
const button = (text, onclick) => make("button", { type: "button", onclick }, text);

const HOURS = [1, 2, 3, 6, 12, 24, 48, 72, 168]; // parts of a day, or days

function ticks(low, high, count, hours = false) {
  const power = 10 ** Math.floor(Math.log10((high - low) / count));
  const round = [1, 2, 5, 10].map((factor) => factor * power);
  const step = [...HOURS.filter((each) => hours && (high - low) / each >= 4), ...round]
    .find((each) => (high - low) / each <= count);
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, k) =>
    Number(((first + k) * step).toPrecision(12)));
}

export function mount(element, connection) {
  const SETS = { even: "", plan: "Plan", yours: "Yours" };
  const view = Math.random().toString(36).slice(2);
  const kept = new Map(); // the times of each name
  const past = []; // the times before each change, for undo
  const asked = new Map(); // what to do with the answer to each message
  const errors = new Map(); // of the last message of each kind
  let facts = null, answer = null, online = false, serial = 0, component = 0, drawn = 0;
  let own = [], selected = null, held = null; // own: objects with a measurement and its handle
  let dragged = false; // whether the held one has moved: a drag is one change
  let pending = null, waiting = null, rest = 0, slow = 0, quiet = 0;

  // --- the elements ------------------------------------------------------------------------------

  const title = make("h1"), about = make("p", { class: "about" });
  const banner = make("p", { class: "banner", role: "status" });
  const chart = draw("svg", { role: "img", height: CHART });
  const choice = make("select", { onchange() { component = +choice.value; paint(); } });
  const choosing = make("label", {}, "Component ", choice);
  const legend = make("p", { class: "legend" });
  const lanes = draw("svg", { class: "lanes", role: "group", "aria-label": "Measurement times" });
  const tools = make("div", { class: "tools" }), remove = button("Remove", () => drop(selected));
  const nudges = [["-", "Earlier", -1], ["+", "Later", 1]].map(([text, title, by]) =>
    filled(button(text, () => nudge(by)), { title, "aria-label": title }, []));
  const undoing = filled(button("Undo", undo), { title: "Ctrl+Z", disabled: "" }, []);
  const verdict = make("dl", { class: "verdict" }), readout = make("dl"), mark = make("p", { class: "mark" });
  const broken = make("ul", { class: "broken" });
  const live = make("p", { class: "live", role: "status" });
  const judging = button(JUDGE, judge), judged = make("div", { class: "judged" });
  const name = make("input", { value: "mine", maxlength: 64, spellcheck: "false" });
  const trouble = make("p", { class: "trouble", role: "alert" });
  const sets = make("ul", { class: "kept" }), command = make("pre", { tabindex: 0, hidden: "" });
  const root = make("div", { class: "pfdist-explorer" }, title, about, banner, verdict, mark,
    make("figure", {}, make("figcaption", {}, legend, choosing), chart, lanes), tools, readout,
    broken, judging, judged, make("div", { class: "tools" }, make("label", {}, "Name ", name),
      button("Name and keep", keep), button("Copy command", copy), button("Download job", save)),
    trouble, sets, command, live);
  judging.className = "main";
  element.append(root);

  // --- messages ----------------------------------------------------------------------------------

  function ask(message, then) {
    const id = `${view}-${++serial}`;
    asked.set(id, (found) => {
      errors.set(message.ask, found.error);
      trouble.textContent = [...errors.values()].filter(Boolean).join(" ");
      then(found);
    });
    connection.send({ ...message, id });
  }

  function want(draws) { // only the newest move is sent, after the answer to the last
    waiting = { ask: "answer", times: times(), draws };
    clearTimeout(rest);
    pump();
  }

  function pump() {
    if (pending || !waiting || !online) return;
    pending = waiting;
    waiting = null;
    slow = setTimeout(() => { banner.textContent = "Computing…"; }, SLOW);
    ask(pending, (found) => {
      pending = null;
      clearTimeout(slow);
      banner.textContent = "";
      if (!found.error) show(found);
      pump();
    });
  }

  connection.start({
    message(found) {
      const then = asked.get(found?.id); // else of another view, or from before a loss
      asked.delete(found?.id);
      then?.(found);
    },
    open() {
      online = true;
      ask({ ask: "state" }, (found) => { if (!found.error) begin(found); });
    },
    lost() {
      online = false;
      asked.clear();
      pending = null;
      busy(false);
      clearTimeout(slow);
      banner.textContent = "Connection lost. Is the command still running? Trying again…";
    },
  });

  // --- constraints -------------------------------------------------------------------------------

  const many = () => facts.sensors.length; // 1 without sensors
  const arrival = (m) => Math.floor(m / many()); // of its value: these count for the spacing of all
  const instant = (m) => arrival(m) - facts.delays[m % many()]; // it is made
  const time = (m) => facts.times[instant(m)];
  const times = () => own.map((each) => each.m).sort((a, b) => a - b);
  const others = (except) => own.filter((each) => each !== except).map((each) => each.m);
  const locked = (each) => facts.required.includes(each.m);

  function allowed(m, beside) {
    const apart = facts.sensors_after[m % many()];
    return !facts.forbidden.has(m) && beside.every((other) => {
      const [low, high] = m < other ? [m, other] : [other, m];
      if (low === high || (facts.after && high < facts.after[low])) return false;
      return !apart || (high - low) % many() || instant(high) >= apart[instant(low)];
    });
  }

  const free = (sensor, beside) =>
    facts.times.map((_, t) => t * many() + sensor).filter((m) => allowed(m, beside));
  const least = (list, key) => list.reduce((a, b) => (key(b) < key(a) ? b : a), list[0]);
  const nearest = (sensor, to, beside) =>
    least(free(sensor, beside), (m) => Math.abs(time(m) - to));

  // --- moving ------------------------------------------------------------------------------------

  function changed() { place(); want(0); }

  function remember() {
    past.push(times());
    undoing.disabled = false;
  }

  function undo() {
    const before = past.pop();
    undoing.disabled = !past.length;
    if (before) restore(before);
  }

  function move(each, m) {
    if (m === undefined || each.m === m || locked(each)) return;
    if (!held || !dragged) remember();
    dragged = Boolean(held);
    each.m = m;
    changed();
  }

  function nudge(by) { // for fingers: the selected time, or the first one
    const each = selected ?? own[0], step = by * many();
    if (!each) return;
    const all = free(each.m % many(), others(each));
    move(each, by > 0 ? all.find((m) => m >= each.m + step)
      : all.reverse().find((m) => m <= each.m + step));
    select(each);
  }

  function add(m) {
    if (m === undefined) return;
    remember();
    own.push({ m });
    changed();
    own.at(-1).handle.focus();
  }

  function addToGap(sensor) { // as far from the others as possible
    const at = others().map(time);
    add(least(free(sensor, others()), (m) =>
      -Math.min(Number.MAX_VALUE, ...at.map((other) => Math.abs(other - time(m))))));
  }

  function drop(each) {
    if (!own.includes(each) || locked(each)) return;
    remember();
    own = own.filter((other) => other !== each);
    each.handle.remove();
    changed();
    least(own, (other) => Math.abs(other.m - each.m))?.handle.focus();
  }

  function use(chosen) {
    remember();
    restore(chosen);
  }

  function restore(chosen) {
    own = chosen.map((m) => ({ m }));
    layout();
    want(0);
  }

  function select(each) {
    selected = own.includes(each) ? each : null;
    own.forEach((other) => other.handle.classList.toggle("selected", other === selected));
    remove.disabled = !selected || locked(selected);
  }

  function key(event, each) {
    const all = free(each.m % many(), others(each)), step = many();
    const page = step * Math.max(2, Math.round(facts.times.length / 10));
    const by = { ArrowRight: step, ArrowUp: step, ArrowLeft: -step, ArrowDown: -step,
      PageUp: page, PageDown: -page, Home: -Infinity, End: Infinity }[event.key];
    if (event.key === "Delete" || event.key === "Backspace") drop(each);
    else if (Math.abs(by) === Infinity) move(each, all.at(by < 0 ? 0 : -1));
    else if (by > 0) move(each, all.find((m) => m >= each.m + by));
    else if (by < 0) move(each, all.reverse().find((m) => m <= each.m + by));
    else return;
    event.preventDefault();
  }

  root.addEventListener("keydown", (event) => {
    if (event.key !== "z" || !(event.ctrlKey || event.metaKey) || event.target === name) return;
    event.preventDefault();
    undo();
  });
  lanes.addEventListener("pointermove", (event) => {
    if (!held) return;
    lanes.setPointerCapture(event.pointerId); // not before: a double click belongs to the handle
    move(held, nearest(held.m % many(), timeAt(event), others(held)));
  });
  lanes.onpointerup = lanes.onpointercancel = () => { held = null; dragged = false; };

  // --- pictures ----------------------------------------------------------------------------------

  const width = () => Math.max(240, root.clientWidth
    - 2 * (parseFloat(getComputedStyle(root).paddingLeft) || 0)); // 0 outside of a document
  const span = () => [facts.times[0], facts.times.at(-1)];
  const wide = () => (width() - LEFT - RIGHT) / (span()[1] - span()[0]); // pixels a unit of time
  const x = (t) => LEFT + (facts.times[t] - span()[0]) * wide();
  const timeAt = (event) =>
    span()[0] + (event.clientX - lanes.getBoundingClientRect().left - LEFT) / wide();
  const shown = () => Object.keys(SETS).filter((set) => set === "yours" || facts[set]);
  const label = (at, text) => draw("text", at, String(text));

  const written = (m) => [facts.labels[instant(m)], facts.unit, facts.sensors[m % many()]]
    .filter((each) => each).join(" ");

  function layout() { // the strips, and new handles
    const height = shown().length * many() * ROW + 4;
    drawn = width();
    lanes.replaceChildren();
    filled(lanes, { viewBox: `0 0 ${width()} ${height}`, height }, []);
    shown().forEach((set, row) => facts.sensors.forEach((sensor, number) =>
      lane(set, sensor, number, (row * many() + number) * ROW + HEAD)));
    own.forEach((each) => { each.handle = handle(each); });
    place();
  }

  function lane(set, sensor, number, y) {
    const mine = set === "yours", middle = y + LANE / 2, last = facts.times.length - 1;
    const strip = draw("rect", { class: `strip ${set}`, x: LEFT - 8, y, height: LANE, rx: 4,
      width: width() - LEFT - RIGHT + 16 });
    lanes.append(label({ x: LEFT, y: y - 5 }, SETS[set] + (sensor && `: ${sensor}`)), strip);
    facts.times.forEach((_, t) => {
      const arrives = t + facts.delays[number], m = arrives * many() + number;
      const from = (x(Math.max(0, t - 1)) + x(t)) / 2;
      const box = { x: from, width: (x(t) + x(Math.min(last, t + 1))) / 2 - from };
      const high = facts.prices ? LANE * 0.8 * (facts.prices[m] ?? 0) / Math.max(...facts.prices) : 0;
      if (facts.prices && mine) {
        lanes.append(draw("rect", { class: "price", ...box, y: y + LANE - high, height: high }));
      }
      if (arrives > last || facts.forbidden.has(m)) {
        lanes.append(draw("rect", { class: "forbidden", ...box, y, height: LANE }));
      }
    });
    if (mine) {
      strip.addEventListener("click", (event) => add(nearest(number, timeAt(event), others())));
      return;
    }
    for (const m of facts[set].filter((each) => each % many() === number)) {
      const inside = (set === "plan" && facts.windows[m]) || [];
      if (inside.length > 1) {
        const [from, to] = [Math.min(...inside), Math.max(...inside)].map(x);
        lanes.append(draw("rect", { class: "window", x: from, y: middle - 2, width: to - from,
          height: 4, rx: 2 }));
      }
      lanes.append(draw("circle", { class: set, cx: x(instant(m)), cy: middle, r: radius() - 2 }));
    }
  }

  const radius = () => Math.max(5, Math.min(8, 0.4 * width() / (own.length + 1)));

  function handle(each) {
    const made = draw("g", { class: "handle", role: "slider", tabindex: 0, "aria-valuemin": 0,
      "aria-valuemax": facts.times.length - 1,
      onpointerdown(event) {
        event.preventDefault(); // selects no text
        made.focus();
        held = each;
      },
      ondblclick: () => drop(each),
      onfocus: () => select(each),
      onkeydown: (event) => key(event, each) },
    draw("circle", { class: "reach", r: 14 }), draw("circle", { class: "yours", r: radius() }));
    lanes.append(made);
    return made;
  }

  function place() { // the handles, each with its place among all
    const rows = (shown().length - 1) * many();
    [...own].sort((a, b) => a.m - b.m).forEach((each, position) => {
      const y = (rows + each.m % many()) * ROW + HEAD + LANE / 2;
      each.handle ??= handle(each);
      filled(each.handle, { "aria-label": `Measurement ${position + 1} of ${own.length}`,
        "aria-valuenow": instant(each.m), "aria-valuetext": written(each.m)
          + (facts.prices ? `, price ${facts.prices[each.m]}` : ""),
        "aria-disabled": locked(each), transform: `translate(${x(instant(each.m))} ${y})` }, []);
    });
    select(selected);
  }

  function paint() { // the error over time
    const { unit } = facts.components[component], bottom = CHART - 26;
    const curves = shown().map((set) => [set, answer.curves[set][component]]);
    const top = 1.08 * Math.max(1e-300, ...curves.flatMap(([, curve]) => curve));
    const y = (value) => bottom - value / top * (bottom - 22);
    chart.replaceChildren(label({ x: 4, y: 12 }, "typical error" + (unit && ` [${unit}]`)
      + " over t" + (facts.unit && ` [${facts.unit}]`)));
    filled(chart, { viewBox: `0 0 ${width()} ${CHART}`,
      "aria-label": `Typical error over time. ${summary()}` }, []);
    for (const value of ticks(0, top, 4)) {
      const [x1, x2, y1] = [LEFT - 8, width() - RIGHT + 8, y(value)];
      chart.append(draw("line", { class: "grid", x1, x2, y1, y2: y1 }),
        label({ x: LEFT - 12, y: y1 + 4, "text-anchor": "end" }, value));
    }
    const isNumber = facts.labels[0] === String(facts.times[0]); // else a date
    const hours = ["h", "hour", "hours"].includes(facts.unit);
    for (const value of ticks(...span(), width() / (isNumber ? 90 : 170), hours)) {
      const t = least([...facts.times.keys()], (each) => Math.abs(facts.times[each] - value));
      const at = isNumber ? LEFT + (value - span()[0]) * wide() : x(t);
      const text = isNumber ? value : facts.labels[t];
      chart.append(draw("line", { class: "grid", x1: at, x2: at, y1: bottom, y2: bottom + 5 }),
        label({ x: at, y: CHART - 8, "text-anchor": isNumber || t ? "middle" : "start" }, text));
    }
    for (const [set, curve] of curves) {
      const points = curve.map((value, t) => value !== null && `${x(t)} ${y(value)}`);
      const d = points.map((at, t) => (at ? (points[t - 1] ? "L" : "M") + at : "")).join("");
      chart.append(draw("path", { class: set, d }));
    }
  }

  // --- answers -----------------------------------------------------------------------------------

  function begin(found) {
    const start = facts ? times() : found.plan ?? found.even;
    facts = { ...found, forbidden: new Set(found.forbidden) };
    SETS.even = found.even_label[0].toUpperCase() + found.even_label.slice(1);
    title.textContent = `When to measure: ${found.model}`;
    about.textContent = `${found.budget}. Drag your times. Click on an empty place to add one; `
      + "double-click or press Delete to remove one. Arrow keys move the time in focus."
      + (found.run && ` The plan is that of ${found.run}.`);
    choosing.hidden = found.components.length < 2;
    choice.replaceChildren(...found.components.map((each, number) =>
      make("option", { value: number }, each.name || `z${number}`)));
    const keys = shown().map((set) => [set, SETS[set]]);
    if (found.forbidden.length) keys.push(["shade", "forbidden"]);
    if (found.prices) keys.push(["money", "price"]);
    const alone = `alone it may move so far, at most ${found.window_percent} % worse`;
    if (Object.keys(found.windows).length) keys.push(["bar", alone]);
    const named = ([kind, text]) => make("span", { class: `key ${kind}` }, text);
    legend.replaceChildren(...keys.map(named));
    tools.replaceChildren(...found.sensors.map((each, number) =>
      button(`Add ${each || "a time"}`, () => addToGap(number))), remove, ...nudges, undoing,
    ...shown().slice(0, -1).map((set) =>
      button(`Start from ${SETS[set].toLowerCase()}`, () => use(facts[set]))));
    list(found.judged);
    restore(start);
  }

  function show(found) {
    answer = found;
    paint();
    const [first, ...others] = found.facts.map(([head, text], place) =>
      make("div", {}, make("dt", {}, place ? head : `expected MSE ${head}`), make("dd", {}, text)));
    verdict.replaceChildren(first); // the paired difference: errors on few draws mislead
    readout.replaceChildren(...others);
    mark.textContent = found.mark;
    broken.replaceChildren(...sentences().map((each) => make("li", {}, each)));
    clearTimeout(quiet);
    quiet = setTimeout(() => { live.textContent = summary(); }, QUIET);
    if (found.finer) rest = setTimeout(() => { if (!waiting) want(found.finer); }, REST);
  }

  const sentences = () =>
    [...answer.broken.map((each) => `Broken constraint: ${each}`), ...answer.warnings];

  function summary() {
    const read = answer.facts.slice(0, 3).map((fact) => fact.join(": "));
    return `Your times: ${[...read, answer.mark, ...sentences()].join(". ")}.`;
  }

  function busy(is) {
    judging.disabled = is;
    judging.textContent = is ? "Judging…" : JUDGE;
  }

  function judge() {
    const chosen = times(), same = [...kept].find(([, each]) => String(each) === String(chosen));
    busy(true);
    ask({ ask: "judge", name: same?.[0] ?? name.value, times: chosen }, (found) => {
      busy(false);
      if (found.error) return;
      list(found.judged);
      want(answer.draws);
    });
  }

  function list(rows) {
    judged.hidden = !rows.length;
    const cell = (text, kind = "td", rest = {}) => make(kind, rest, text);
    const together = rows.length > 1 && `The ${rows.length} intervals hold together with 95 %. `;
    judged.replaceChildren(make("table", {}, make("caption", {}, "Judged on fresh draws. ",
      together || "", "The best of several sets is judged once more: picking it flatters it."),
    make("thead", {}, make("tr", {}, ...["set",
      `expected MSE against ${facts.plan ? "the plan" : facts.even_label}`, "times"]
      .map((each) => cell(each, "th", { scope: "col" })))),
    make("tbody", {}, ...rows.map((each) => make("tr", {},
      cell(each.name + (each.again ? " (judged once more)" : ""), "th", { scope: "row" }),
      cell(each.text + (each.draws && `, ${each.draws.toLocaleString("en")} draws`)),
      cell(each.written))))));
  }

  // --- to take away ------------------------------------------------------------------------------

  function take(chosen, then) {
    ask({ ask: "take", sets: Object.fromEntries(chosen) }, (found) => {
      if (found.error) return;
      command.hidden = false;
      command.textContent = found.command;
      then(found);
    });
  }

  function keep() {
    const named = [name.value, times()];
    take([...kept, named], () => {
      kept.set(...named);
      sets.replaceChildren(...[...kept].map(([each, chosen]) => make("li", {},
        button(`Use ${each}`, () => use(chosen)), ` ${chosen.map(written).join(", ")}`)));
    });
  }

  const all = () => (kept.size ? [...kept] : [[name.value, times()]]);
  function copy() { take(all(), (found) => navigator.clipboard?.writeText(found.command)); }
  function save() {
    take(all(), (found) => {
      const href = URL.createObjectURL(new Blob([found.job]));
      make("a", { href, download: "explored.toml" }).click();
      setTimeout(() => URL.revokeObjectURL(href), AGAIN);
    });
  }

  const resized = new ResizeObserver(() => {
    if (answer && drawn !== width()) { layout(); paint(); } // not if texts grow: focus would go
  });
  resized.observe(root);
  return () => resized.disconnect();
}

// --- connections ---------------------------------------------------------------------------------

function socket() { // of the local page
  let open;
  function start(on) {
    open = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws")));
    open.onopen = on.open;
    open.onmessage = (event) => on.message(JSON.parse(event.data));
    open.onclose = () => { on.lost(); setTimeout(() => start(on), AGAIN); };
  }
  return { start, send: (message) => open.send(JSON.stringify(message)) };
}

export default { // of a notebook
  render({ model, el }) {
    let heard;
    const stop = mount(el, { send: (message) => model.send(message), start(on) {
      heard = on.message;
      model.on("msg:custom", heard);
      queueMicrotask(on.open);
    } });
    return () => { model.off("msg:custom", heard); stop(); };
  },
};

if (document.documentElement.dataset.pfdist === "explore") {
  mount(document.querySelector("main"), socket());
}
