// The page's own script: buttons that move the robot only while they are held, and bars of joint angles.
//
// The viewer sends a token every 40 ms while a button is held. Each is returned here at once, in the thread
// that also sees the pointer: a page that is frozen or hidden returns none, and the viewer stops the motion.
(() => {
  "use strict";
  const AGAIN = 1000; // ms between two looks for something to connect for
  let socket = null;
  let number = 0;
  let held = null; // {button, pointer, number}
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

  function release() {
    if (!held) return;
    send({ press: held.number });
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
    newest = held = { button, pointer: event.pointerId, number };
    button.setAttribute("data-held", "");
    button.setPointerCapture(event.pointerId);
    for (const place of document.querySelectorAll("[data-twind-answer]")) place.textContent = "";
    const key = document.querySelector("[data-twind-key]")?.dataset.twindKey ?? "";
    send({ press: number, key, kind: button.dataset.twindKind, name: button.dataset.twindName });
  }

  function lift(event) {
    if (held && event.pointerId === held.pointer) release();
  }

  function leave(event) {
    if (!held || event.pointerId !== held.pointer) return;
    const edge = held.button.getBoundingClientRect();
    const inside =
      event.clientX >= edge.left && event.clientX <= edge.right &&
      event.clientY >= edge.top && event.clientY <= edge.bottom;
    if (!inside) release();
  }

  const isHeldHere = () =>
    held && document.visibilityState === "visible" && held.button.isConnected;

  function take(message) {
    if ("token" in message) {
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
    }
  }

  function connect() {
    if (socket && socket.readyState <= WebSocket.OPEN) return;
    if (!document.querySelector("[data-twind-row]")) return;
    const base = location.pathname.replace(/\/[^/]*$/, "");
    socket = new WebSocket(`ws://${location.host}${base}/twind`);
    socket.onmessage = (event) => take(JSON.parse(event.data));
    socket.onclose = release;
  }
  setInterval(connect, AGAIN);
})();
