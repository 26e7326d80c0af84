// The page's own script: stop buttons, buttons that move the robot only while they are held, joint angles.
//
// The viewer sends a token every 40 ms while a button is held. Each is returned here at once, in the thread
// that also sees the pointer: a page that is frozen or hidden returns none, and the viewer stops the motion.
(() => {
  "use strict";
  const AGAIN = 500; // ms between two tries to connect
  const NARROW = "(max-width: 900px)"; // below it viser's own layout for small screens is used

  // Before viser's script runs: its theme and its layout follow the screen.
  const search = new URLSearchParams(location.search);
  if (matchMedia("(prefers-color-scheme: dark)").matches && !search.has("darkMode"))
    history.replaceState(null, "", `${location.pathname}?darkMode`);
  const ask = window.matchMedia.bind(window);
  window.matchMedia = (query) => ask(query === "(max-width: 36em)" ? NARROW : query);

  let socket = null;
  let number = 0;
  let held = null; // {button, pointer, number, value}
  let newest = null; // the newest of them: its refusal may come after its release

  const rowOf = (button) => button.closest("[data-twind-row]");

  function say(button, text, done) {
    const place = rowOf(button)?.querySelector("[data-twind-answer]");
    if (!place) return;
    place.textContent = text;
    place.dataset.done = String(done);
  }

  function send(message) {
    if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  }

  // Value of a slider under the pointer, rad; null: the control is a button.
  function valueAt(button, event) {
    if (!button.classList.contains("tw-slider")) return null;
    const edge = button.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - edge.left) / edge.width));
    const lower = Number(rowOf(button).dataset.lower);
    const upper = Number(rowOf(button).dataset.upper);
    const mark = button.querySelector(".tw-to");
    mark.hidden = false;
    mark.style.left = `${(100 * share).toFixed(2)}%`;
    return Math.min(upper, Math.max(lower, lower + share * (upper - lower)));
  }

  function release() {
    if (!held) return;
    send({ press: held.number });
    const mark = held.button.querySelector(".tw-to");
    if (mark) mark.hidden = true;
    held.button.removeAttribute("data-held");
    held = null;
  }

  function press(event) {
    const button = event.target.closest?.("[data-twind-kind]");
    if (!button || event.button !== 0 || !event.isTrusted) return;
    event.preventDefault();
    release();
    if (socket?.readyState !== WebSocket.OPEN) {
      say(button, "not moved: no connection to the viewer", false);
      return;
    }
    number += 1;
    const value = valueAt(button, event);
    newest = held = { button, pointer: event.pointerId, number, value };
    button.setAttribute("data-held", "");
    button.setPointerCapture(event.pointerId);
    for (const place of document.querySelectorAll("[data-twind-answer]")) place.textContent = "";
    const key = document.querySelector("[data-twind-key]")?.dataset.twindKey ?? "";
    const asked = { press: number, key, kind: button.dataset.twindKind, name: button.dataset.twindName };
    send(value === null ? asked : { ...asked, value });
  }

  function lift(event) {
    if (held && event.pointerId === held.pointer) release();
  }

  function leave(event) {
    if (!held || event.pointerId !== held.pointer) return;
    if (held.value !== null && event.buttons & 1) { // a slider is dragged beyond its edges
      send({ press: held.number, value: valueAt(held.button, event) });
      return;
    }
    const edge = held.button.getBoundingClientRect();
    const inside =
      event.clientX >= edge.left && event.clientX <= edge.right &&
      event.clientY >= edge.top && event.clientY <= edge.bottom;
    // A mouse reports no pointerup while another of its buttons is down, and one may be lost.
    if (!inside || !(event.buttons & 1)) release();
  }

  const isHeldHere = () =>
    held && document.visibilityState === "visible" && held.button.isConnected;

  function take(message) {
    if ("stops" in message) {
      if (message.stops.length) addStops();
    } else if ("stop" in message) {
      tell(`${message.title}: ${message.text}`, message.done);
    } else if ("token" in message) {
      if (held?.number !== message.press) return;
      if (isHeldHere()) send({ press: message.press, token: message.token });
      else release();
    } else if ("title" in message) {
      if (newest?.number !== message.press) return;
      const wasHeld = held === newest;
      release();
      if (wasHeld || message.title !== "lapsed")
        say(newest.button, [message.title, message.text].filter(Boolean).join(": "), message.done);
    } else if (message.position) {
      show(message);
    }
  }

  document.addEventListener("pointerdown", press, true);
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
    document.addEventListener(name, lift, true);
  document.addEventListener("pointermove", leave, true);
  document.addEventListener("contextmenu", (event) => {
    if (event.target.closest?.("[data-twind-kind]")) event.preventDefault(); // of a long touch
  }, true);
  document.addEventListener("visibilitychange", release);
  for (const name of ["pagehide", "freeze", "blur"]) window.addEventListener(name, release);

  function show(values) {
    for (const row of document.querySelectorAll("[data-twind-row][data-place]")) {
      const place = Number(row.dataset.place);
      const lower = Number(row.dataset.lower);
      const span = Number(row.dataset.upper) - lower;
      for (const [name, mark] of [["position", ".tw-is"], ["goal", ".tw-goal"]]) {
        const value = values[name]?.[place];
        const part = row.querySelector(mark);
        part.hidden = typeof value !== "number";
        if (part.hidden) continue;
        const share = Math.min(1, Math.max(0, (value - lower) / span));
        part.style.left = `${(100 * share).toFixed(2)}%`;
        if (name === "position") row.dataset.near = String(share < 0.05 || share > 0.95);
      }
      const value = values.position[place];
      const text = typeof value === "number" ? value.toFixed(3) : "–";
      const number = row.querySelector(".tw-number");
      if (number.textContent !== text) number.textContent = text;
      const torque = values.external?.[place]; // N·m, with an identified model alone
      const outside = typeof torque === "number" ? `${torque < 0 ? "−" : "+"}${Math.abs(torque).toFixed(2)} N·m` : "";
      const felt = row.querySelector(".tw-outside");
      if (felt.textContent !== outside) felt.textContent = outside;
      row.dataset.contact = String(values.contact?.[place] === true);
    }
  }

  function connect() {
    if (socket && socket.readyState <= WebSocket.OPEN) return;
    const base = location.pathname.replace(/\/[^/]*$/, "");
    socket = new WebSocket(`ws://${location.host}${base}/twind`);
    socket.onmessage = (event) => take(JSON.parse(event.data));
    socket.onclose = release;
  }

  function tell(text, done) {
    const place = document.querySelector(".tw-stops output");
    place.textContent = text;
    place.dataset.done = String(done);
  }

  function addStops() {
    if (document.querySelector(".tw-stops")) return;
    const bar = document.createElement("div");
    bar.className = "tw-stops";
    for (const [name, text, title] of [
      ["estop", "E-STOP", "lower the robot, torque off, latched"],
      ["stop", "Stop", "the motion comes to a hold; needs an operator"],
    ]) {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: text, title, className: `tw-${name}` });
      button.addEventListener("click", () => {
        release();
        if (socket?.readyState !== WebSocket.OPEN) {
          tell(`${text} NOT sent: no connection to the viewer; use its own switch`, false);
          return;
        }
        tell(`${text} …`, true);
        send({ press: number, stop: name });
      });
      bar.append(button);
    }
    bar.append(document.createElement("output"));
    document.body.append(bar);
    document.body.dataset.twindStops = "";
    window.dispatchEvent(new Event("resize"));
  }

  connect();
  setInterval(connect, AGAIN);
})();
