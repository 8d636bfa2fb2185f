"use strict";
// Fetches the page's content every two seconds, replaces what has changed, and warns when the monitor is silent.
const EVERY_MS = 2000, EVERY_WHEN_OVER_MS = 20000, PATIENCE_MS = 10000, LOST_AFTER_S = 5;
const sent = new Map();
let answeredAt = performance.now(), lostAt = 0, whyLost = "";

function say(text) {
  const link = document.getElementById("link");
  if (link.textContent !== text) link.textContent = text;
  link.hidden = !text;
}

function showLocalTimes(root) {
  for (const time of root.querySelectorAll("time")) {
    time.title = time.textContent;
    time.textContent = new Date(time.dateTime).toLocaleString([],
      {weekday: "short", day: "numeric", month: "short", hour: "2-digit", minute: "2-digit"});
  }
}

function swap(old, fresh) {
  const focused = old.contains(document.activeElement) ? document.activeElement.id : "";
  const places = [...old.querySelectorAll(".scroll")].map(each => [each.id, each.scrollLeft, each.scrollTop]);
  const unfolded = [...old.querySelectorAll("details[open]")].map(each => each.id);
  old.className = fresh.className;
  old.hidden = fresh.hidden;
  old.replaceChildren(...fresh.childNodes);
  showLocalTimes(old);
  for (const [id, left, top] of places) document.getElementById(id)?.scrollTo(left, top);
  for (const id of unfolded) document.getElementById(id)?.setAttribute("open", "");
  if (focused) document.getElementById(focused)?.focus({preventScroll: true});
}

function show(text) {
  const fresh = new DOMParser().parseFromString(text, "text/html").getElementById("live");
  const live = document.getElementById("live");
  const parts = [...fresh.querySelectorAll("[data-live]")];
  if (parts.some(part => !document.getElementById(part.id)) ||
      [...live.querySelectorAll("[data-live]")].some(part => !fresh.querySelector("#" + part.id))) {
    location.reload();  // another kind of page: a run has started, or its folder is readable again
    return;
  }
  for (const part of parts) {
    if (sent.get(part.id) === part.outerHTML) continue;
    sent.set(part.id, part.outerHTML);
    swap(document.getElementById(part.id), part);
  }
  Object.assign(live.dataset, fresh.dataset);
  document.title = fresh.dataset.title;
  answeredAt = performance.now();
}

function showAge() {
  const now = performance.now(), live = document.getElementById("live").dataset;
  const lost = lostAt ? (now - lostAt) / 1000 : 0, age = Number(live.ageS) + (now - answeredAt) / 1000;
  if (lost > LOST_AFTER_S) {
    say(`▲ No answer from the monitor for ${Math.round(lost)} s (${whyLost}). The page below is out of date.`);
    document.title = `▲ no answer: ${live.title}`;
  } else {
    say("");
  }
  const place = document.getElementById("age");
  if (place) place.textContent = live.over === "yes" ? "" : `Snapshot ${Math.round(age)} s old.`;
}

async function look() {
  try {
    const reply = await fetch("fragment", {cache: "no-store", signal: AbortSignal.timeout(PATIENCE_MS)});
    if (!reply.ok) throw new Error(`status ${reply.status} ${reply.statusText}`);
    show(await reply.text());
    lostAt = 0;
  } catch (error) {
    lostAt ||= performance.now();
    whyLost = error.message;
  }
  const isOver = document.getElementById("live").dataset.over === "yes";
  setTimeout(look, isOver && !lostAt ? EVERY_WHEN_OVER_MS : EVERY_MS);
}

for (const part of document.querySelectorAll("[data-live]")) sent.set(part.id, part.outerHTML);
showLocalTimes(document);
document.title = document.getElementById("live").dataset.title;
setInterval(showAge, 1000);
setTimeout(look, EVERY_MS);
