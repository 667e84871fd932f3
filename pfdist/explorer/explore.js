// The page and the widget: times are moved by hand, and the error follows.
//
// All texts reach the page as text, never as markup. `connection` has start({open, message, lost})
// and send(message); messages are those of pfdist.explorer.session.reply.

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 46, RIGHT = 14, CHART = 230, LANE = 24, HEAD = 18;
const SETS = { even: "Evenly spaced", plan: "Plan", yours: "Yours" };
const REST = 300, SLOW = 1000, QUIET = 900, AGAIN = 1000; // milliseconds

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value !== null) element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}

function draw(tag, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

function ticks(low, high, count) {
  if (!(high > low)) return [low];
  const power = 10 ** Math.floor(Math.log10((high - low) / count));
  const step = [1, 2, 5, 10].map((factor) => factor * power)
    .find((each) => (high - low) / each <= count);
  const first = Math.ceil(low / step - 1e-9);
  const number = Math.floor(high / step + 1e-9) - first + 1;
  return Array.from({ length: number }, (_, k) => Number(((first + k) * step).toPrecision(12)));
}

export function mount(element, connection) {
  const view = Math.random().toString(36).slice(2);
  const kept = new Map(); // name -> times
  const asked = new Map(); // id -> what its answer is for
  let facts = null, answer = null, judged = [], online = false, serial = 0, component = 0;
  let own = [], selected = null, held = null; // own: objects with a measurement and its handle
  let pending = null, waiting = null, rest = 0, slow = 0, quiet = 0;

  // --- the elements ------------------------------------------------------------------------------

  const title = make("h1"), about = make("p", { class: "about" });
  const banner = make("p", { class: "banner", role: "status" });
  const chart = draw("svg", { class: "chart", role: "img" });
  const choice = make("select", { onchange: () => { component = Number(choice.value); paint(); } });
  const choosing = make("label", { class: "component" }, "Component ", choice);
  const legend = make("p", { class: "legend" });
  const lanes = draw("svg", { class: "lanes", role: "group", "aria-label": "Measurement times" });
  const tools = make("div", { class: "tools" });
  const remove = make("button", { type: "button", onclick: () => drop(selected) }, "Remove");
  const readout = make("dl", { class: "readout" }), mark = make("p", { class: "mark" });
  const broken = make("ul", { class: "broken" });
  const live = make("p", { class: "live", role: "status", "aria-live": "polite" });
  const judging = make("button", { type: "button", class: "main", onclick: judge },
    "Judge on fresh draws");
  const fresh = make("div", { class: "judged" });
  const name = make("input", { value: "mine", maxlength: 64, spellcheck: "false" });
  const sets = make("ul", { class: "kept" }), command = make("pre", { tabindex: "0" });
  const trouble = make("p", { class: "trouble", role: "alert" });
  const taking = make("div", { class: "tools" },
    make("label", {}, "Name ", name),
    make("button", { type: "button", onclick: keep }, "Name and keep"),
    make("button", { type: "button", onclick: copy }, "Copy command"),
    make("button", { type: "button", onclick: download }, "Download job"));
  const root = make("div", { class: "pfdist-explorer" }, title, about, banner,
    make("figure", {}, make("figcaption", {}, legend, choosing), chart, lanes), tools,
    make("div", { class: "answer" }, make("div", {}, readout, mark), broken), judging, fresh,
    taking, trouble, sets, command, live);
  element.append(root);
  command.hidden = true;

  // --- messages ----------------------------------------------------------------------------------

  function ask(message, then) {
    const id = `${view}-${++serial}`;
    asked.set(id, then);
    connection.send({ ...message, id });
    return id;
  }

  function heard(message) {
    const then = asked.get(message?.id);
    if (!then) return; // of another view, or from before the connection was lost
    asked.delete(message.id);
    then(message);
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
    clearTimeout(slow);
    slow = setTimeout(() => tell("Computing…"), SLOW);
    ask(pending, (found) => {
      pending = null;
      clearTimeout(slow);
      tell("");
      if (found.error) trouble.textContent = found.error;
      else show(found);
      pump();
    });
  }

  function tell(text) { if (banner.textContent !== text) banner.textContent = text; }

  connection.start({
    message: heard,
    open() {
      online = true;
      tell("");
      ask({ ask: "state" }, (found) => {
        if (found.error) tell(found.error);
        else begin(found);
      });
    },
    lost() {
      online = false;
      asked.clear();
      waiting = waiting ?? pending;
      pending = null;
      judging.disabled = false;
      judging.textContent = "Judge on fresh draws";
      clearTimeout(slow);
      tell("Connection lost. Is the command still running? Trying again…");
    },
  });

  // --- constraints -------------------------------------------------------------------------------

  const many = () => Math.max(1, facts.sensors.length);
  const instant = (m) => Math.floor(m / many());
  const times = () => own.map((each) => each.m).sort((a, b) => a - b);
  const others = (except) => own.filter((each) => each !== except).map((each) => each.m);

  function allowed(m, beside) {
    if (facts.forbidden.has(m)) return false;
    const sensor = m % many(), apart = facts.sensors_after[sensor];
    return beside.every((other) => {
      const [low, high] = m < other ? [m, other] : [other, m];
      if (low === high || (facts.after && high < facts.after[low])) return false;
      return !apart || other % many() !== sensor || instant(high) >= apart[instant(low)];
    });
  }

  function free(sensor, beside) {
    const every = facts.times.map((_, t) => t * many() + sensor);
    return every.filter((m) => allowed(m, beside));
  }

  function nearest(sensor, time, beside) {
    const far = (m) => Math.abs(facts.times[instant(m)] - time);
    return free(sensor, beside).reduce((a, b) => (a !== null && far(a) <= far(b) ? a : b), null);
  }

  // --- moving ------------------------------------------------------------------------------------

  function move(each, m) {
    if (m === null || m === undefined || each.m === m || locked(each)) return;
    each.m = m;
    changed();
  }

  function locked(each) { return facts.required.includes(each.m); }

  function add(m) {
    if (m === null || m === undefined) return;
    const each = { m };
    own.push(each);
    changed();
    select(each);
    each.handle.focus();
  }

  function addToGap(sensor) { // as far from the others as possible
    const at = others().map(instant);
    const far = (m) => Math.min(Infinity, ...at.map((t) =>
      Math.abs(facts.times[t] - facts.times[instant(m)])));
    const [first, ...more] = free(sensor, others());
    add(more.reduce((a, b) => (far(b) > far(a) ? b : a), first));
  }

  function drop(each) {
    if (!each || locked(each) || !own.includes(each)) return;
    const next = own.filter((other) => other !== each)
      .sort((a, b) => Math.abs(a.m - each.m) - Math.abs(b.m - each.m))[0];
    own = own.filter((other) => other !== each);
    each.handle.remove();
    selected = null;
    changed();
    if (next) next.handle.focus();
  }

  function use(chosen) {
    own.forEach((each) => each.handle?.remove());
    own = chosen.map((m) => ({ m }));
    selected = null;
    changed();
  }

  function changed() { place(); want(0); }

  function select(each) {
    selected = each;
    own.forEach((other) => other.handle.classList.toggle("selected", other === each));
    remove.disabled = !each || locked(each);
  }

  function key(event, each) {
    const size = facts.times.length, sensor = each.m % many(), beside = others(each);
    const forward = (from) => free(sensor, beside).find((m) => m >= from);
    const back = (from) => free(sensor, beside).reverse().find((m) => m <= from);
    const step = many(), page = many() * Math.max(2, Math.round(size / 10));
    const keys = {
      ArrowRight: () => forward(each.m + step), ArrowUp: () => forward(each.m + step),
      ArrowLeft: () => back(each.m - step), ArrowDown: () => back(each.m - step),
      PageUp: () => forward(each.m + page), PageDown: () => back(each.m - page),
      Home: () => forward(0), End: () => back(size * many()),
    };
    if (event.key === "Delete" || event.key === "Backspace") drop(each);
    else if (event.key in keys) move(each, keys[event.key]());
    else return;
    event.preventDefault();
  }

  // --- pictures ----------------------------------------------------------------------------------

  const width = () => Math.max(240, root.clientWidth - 2);
  function x(t) {
    const [first, last] = [facts.times[0], facts.times.at(-1)];
    return LEFT + (facts.times[t] - first) / (last - first) * (width() - LEFT - RIGHT);
  }
  function timeAt(event) {
    const box = lanes.getBoundingClientRect(), [first, last] = [facts.times[0], facts.times.at(-1)];
    return first + (event.clientX - box.left - LEFT) / (width() - LEFT - RIGHT) * (last - first);
  }
  function written(m) {
    const sensor = facts.sensors[m % many()];
    const time = `${facts.labels[instant(m)]} ${facts.unit}`.trim();
    const price = facts.prices ? `, price ${facts.prices[m]}` : "";
    return `${sensor ? `${sensor}, ` : ""}${time}${price}`;
  }
  const shown = () => Object.keys(SETS).filter((set) => set === "yours" || facts[set]);

  function layout() { // the strips, without the handles
    lanes.replaceChildren();
    const rows = shown().flatMap((set) => (facts.sensors.length ? facts.sensors : [""])
      .map((sensor, number) => ({ set, sensor, number })));
    const height = rows.length * (LANE + HEAD) + 4, highest = Math.max(...(facts.prices ?? [1]));
    lanes.setAttribute("viewBox", `0 0 ${width()} ${height}`);
    lanes.setAttribute("height", height);
    rows.forEach(({ set, sensor, number }, row) => {
      const top = row * (LANE + HEAD) + HEAD, mine = set === "yours";
      const head = draw("text", { x: LEFT, y: top - 5 });
      head.textContent = SETS[set] + (sensor ? `: ${sensor}` : "");
      const strip = draw("rect", { class: mine ? "strip mine" : "strip", x: LEFT - 8, y: top,
        width: width() - LEFT - RIGHT + 16, height: LANE, rx: 4 });
      lanes.append(head, strip);
      const half = (t) => [(x(Math.max(0, t - 1)) + x(t)) / 2,
        (x(t) + x(Math.min(facts.times.length - 1, t + 1))) / 2];
      facts.times.forEach((_, t) => {
        const m = t * many() + number, [from, to] = half(t), box = { x: from, width: to - from };
        if (facts.prices && mine) {
          const high = LANE * 0.8 * facts.prices[m] / highest;
          lanes.append(draw("rect", { class: "price", ...box, y: top + LANE - high, height: high }));
        }
        if (facts.forbidden.has(m)) {
          lanes.append(draw("rect", { class: "forbidden", ...box, y: top, height: LANE }));
        }
      });
      if (mine) {
        strip.addEventListener("click", (event) => add(nearest(number, timeAt(event), others())));
        return;
      }
      for (const m of facts[set].filter((each) => each % many() === number)) {
        const inside = set === "plan" ? facts.windows[m] : null, at = x(instant(m));
        if (inside) {
          const ends = [x(Math.min(...inside)), x(Math.max(...inside))];
          lanes.append(draw("rect", { class: "window", x: ends[0] - 2, y: top + LANE / 2 - 2,
            width: ends[1] - ends[0] + 4, height: 4, rx: 2 }));
        }
        lanes.append(draw("circle", { class: set, cx: at, cy: top + LANE / 2, r: 5 }));
      }
    });
    own.forEach((each) => { each.handle = null; });
    place();
  }

  function place() { // the handles
    const fixed = shown().length - 1, number = own.length;
    times().forEach((m, position) => {
      const each = own.find((other) => other.m === m);
      if (!each.handle) each.handle = handle(each);
      const row = fixed * many() + m % many(), t = instant(m);
      const at = { "aria-label": `Measurement ${position + 1} of ${number}`, "aria-valuenow": t,
        "aria-valuetext": written(m), "aria-disabled": String(locked(each)),
        transform: `translate(${x(t)} ${row * (LANE + HEAD) + HEAD + LANE / 2})` };
      for (const [key, value] of Object.entries(at)) each.handle.setAttribute(key, value);
    });
    select(own.includes(selected) ? selected : null);
    const line = own.map((each) => x(instant(each.m)));
    chart.querySelectorAll(".at").forEach((each, k) => each.setAttribute("x1", line[k] ?? 0));
  }

  function handle(each) {
    const made = draw("g", { class: "handle", role: "slider", tabindex: 0, "aria-valuemin": 0,
      "aria-valuemax": facts.times.length - 1 },
    draw("circle", { class: "reach", r: 14 }), draw("circle", { class: "yours", r: 8 }));
    made.addEventListener("pointerdown", (event) => {
      event.preventDefault(); // selects no text
      made.focus();
      held = each;
      lanes.setPointerCapture(event.pointerId);
    });
    made.addEventListener("dblclick", () => drop(each));
    made.addEventListener("focus", () => select(each));
    made.addEventListener("keydown", (event) => key(event, each));
    lanes.append(made);
    return made;
  }

  lanes.addEventListener("pointermove", (event) => {
    if (held) move(held, nearest(held.m % many(), timeAt(event), others(held)));
  });
  for (const end of ["pointerup", "pointercancel"]) {
    lanes.addEventListener(end, () => { held = null; });
  }

  function paint() { // the error over time
    if (!facts || !answer) return;
    const curves = Object.fromEntries(shown().map((set) => [set, answer.curves[set][component]]));
    const unit = facts.components[component].unit, bottom = CHART - 26;
    const top = Math.max(1e-300, ...Object.values(curves).flat().filter((v) => v !== null));
    const y = (value) => bottom - value / (1.08 * top) * (bottom - 22);
    chart.replaceChildren();
    chart.setAttribute("viewBox", `0 0 ${width()} ${CHART}`);
    chart.setAttribute("height", CHART);
    for (const value of ticks(0, 1.08 * top, 4)) {
      const text = draw("text", { x: LEFT - 12, y: y(value) + 4, "text-anchor": "end" });
      text.textContent = value;
      chart.append(draw("line", { class: "grid", x1: LEFT - 8, x2: width() - RIGHT + 8,
        y1: y(value), y2: y(value) }), text);
    }
    const span = [facts.times[0], facts.times.at(-1)];
    for (const value of ticks(...span, width() / 90)) {
      const t = facts.times.reduce((a, time, b) =>
        (Math.abs(time - value) < Math.abs(facts.times[a] - value) ? b : a), 0);
      const text = draw("text", { x: x(t), y: CHART - 8, "text-anchor": "middle" });
      text.textContent = facts.labels[t];
      chart.append(draw("line", { class: "grid", x1: x(t), x2: x(t), y1: bottom, y2: bottom + 5 }),
        text);
    }
    const head = draw("text", { x: 4, y: 12 });
    head.textContent = `typical error${unit ? ` [${unit}]` : ""} at t`
      + `${facts.unit ? ` [${facts.unit}]` : ""}`;
    chart.append(head);
    for (const [set, curve] of Object.entries(curves)) {
      const path = curve.map((value, t) => (value === null ? ""
        : `${t && curve[t - 1] !== null ? "L" : "M"}${x(t).toFixed(1)} ${y(value).toFixed(1)}`));
      chart.append(draw("path", { class: set, d: path.join("") }));
    }
    chart.setAttribute("aria-label", `Typical error over time. ${summary()}`);
  }

  // --- answers -----------------------------------------------------------------------------------

  function begin(found) {
    const again = facts !== null;
    facts = { ...found, forbidden: new Set(found.forbidden) };
    judged = found.judged;
    title.textContent = `When to measure: ${found.model}`;
    about.textContent = `${found.budget}. Drag your times, click on an empty place to add one, `
      + "double-click or press Delete to remove one; arrow keys move the time in focus."
      + (found.run ? ` Plan of ${found.run}.` : "");
    choosing.hidden = found.components.length < 2;
    choice.replaceChildren(...found.components.map((each, number) =>
      make("option", { value: number }, each.name || "z")));
    legend.replaceChildren(...shown().map((set) =>
      make("span", { class: `key ${set}` }, SETS[set])));
    if (found.forbidden.length) legend.append(make("span", { class: "key shade" }, "forbidden"));
    if (Object.keys(found.windows).length) {
      legend.append(make("span", { class: "key window" },
        `may move alone (at most ${found.window_percent} % worse)`));
    }
    const lists = facts.sensors.length ? facts.sensors : [""];
    tools.replaceChildren(...lists.map((sensor, number) => make("button",
      { type: "button", onclick: () => addToGap(number) }, `Add ${sensor || "a time"}`)), remove,
    ...shown().filter((set) => set !== "yours").map((set) => make("button",
      { type: "button", onclick: () => use(facts[set]) }, `Start from ${SETS[set].toLowerCase()}`)));
    list();
    if (!again) own = found.start.map((m) => ({ m }));
    layout();
    want(0);
  }

  function show(found) {
    answer = found;
    trouble.textContent = "";
    paint();
    readout.replaceChildren(...found.facts.map(([head, text]) =>
      make("div", {}, make("dt", {}, head), make("dd", {}, text))));
    mark.textContent = found.draws ? `${found.mark} (${found.draws.toLocaleString("en")} draws)`
      : found.mark;
    const sentences = found.broken.map((each) => `Broken constraint: ${each}`);
    broken.replaceChildren(...[...sentences, ...found.warnings].map((each) => make("li", {}, each)));
    clearTimeout(quiet);
    quiet = setTimeout(() => { live.textContent = summary(); }, QUIET);
    if (waiting || found.finer === null) return;
    rest = setTimeout(() => { if (!waiting && !pending && !held) want(found.finer); }, REST);
  }

  function summary() {
    const [typical, , against] = answer.facts;
    const gain = against && against[0].startsWith("against") ? `, ${against.join(": ")}` : "";
    return `Your times: typical error ${typical[1]}${gain}; ${answer.mark}. `
      + answer.broken.map((each) => `Broken constraint: ${each}.`).join(" ");
  }

  function nameOf(chosen) {
    const same = [...kept].find(([, each]) => each.join() === chosen.join());
    return same ? same[0] : name.value;
  }

  function judge() {
    const chosen = times();
    judging.disabled = true;
    judging.textContent = "Judging…";
    ask({ ask: "judge", name: nameOf(chosen), times: chosen }, (found) => {
      judging.disabled = false;
      judging.textContent = "Judge on fresh draws";
      trouble.textContent = found.error ?? "";
      if (found.error) return;
      judged = found.judged;
      list();
      want(answer?.draws ?? 0);
    });
  }

  function list() {
    fresh.hidden = !judged.length;
    const rows = judged.map((each) => make("tr", {},
      make("th", { scope: "row" }, each.name + (each.again ? " (judged once more)" : "")),
      make("td", {}, each.text), make("td", {}, each.draws ? each.draws.toLocaleString("en") : ""),
      make("td", {}, each.written)));
    fresh.replaceChildren(make("table", {},
      make("caption", {}, "On fresh draws, the expected MSE against evenly spaced times. "
        + (judged.length > 1 ? `The ${judged.length} intervals hold together with 95 %. ` : "")
        + "The best of several sets is judged once more, because picking it flatters it."),
      make("thead", {}, make("tr", {}, ...["set", "expected MSE", "draws", "times"].map((head) =>
        make("th", { scope: "col" }, head)))), make("tbody", {}, ...rows)));
  }

  // --- to take away ------------------------------------------------------------------------------

  function take(chosen, then) {
    ask({ ask: "take", sets: Object.fromEntries(chosen) }, (found) => {
      trouble.textContent = found.error ?? "";
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
        make("button", { type: "button", onclick: () => use(chosen) }, `Use ${each}`),
        ` ${chosen.map((m) => facts.labels[instant(m)]).join(", ")}`)));
    });
  }

  const chosen = () => (kept.size ? [...kept] : [[name.value, times()]]);
  function copy() { take(chosen(), (found) => navigator.clipboard?.writeText(found.command)); }
  function download() {
    take(chosen(), (found) => {
      const address = URL.createObjectURL(new Blob([found.job], { type: "application/toml" }));
      make("a", { href: address, download: "explored.toml" }).click();
      setTimeout(() => URL.revokeObjectURL(address), AGAIN);
    });
  }

  const resized = new ResizeObserver(() => { if (facts) { layout(); paint(); } });
  resized.observe(root);
  return () => resized.disconnect();
}

// --- connections ---------------------------------------------------------------------------------

function socket() { // of the local page
  let open;
  const connect = (on) => {
    open = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws")));
    open.onopen = on.open;
    open.onmessage = (event) => on.message(JSON.parse(event.data));
    open.onclose = () => { on.lost(); setTimeout(() => connect(on), AGAIN); };
  };
  return { start: connect, send: (message) => open.send(JSON.stringify(message)) };
}

export default { // of a notebook
  render({ model, el }) {
    let heard;
    const stop = mount(el, {
      start(on) { heard = on.message; model.on("msg:custom", heard); queueMicrotask(on.open); },
      send: (message) => model.send(message),
    });
    return () => { model.off("msg:custom", heard); stop(); };
  },
};

if (document.documentElement.dataset.pfdist === "explore") {
  mount(document.querySelector("main"), socket());
}
