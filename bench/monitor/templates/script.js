"use strict";
// Fetches the page's content every two seconds, replaces what has changed, and warns when the monitor is silent.
const POLL_MS = 2000, POLL_WHEN_OVER_MS = 20000, TIMEOUT_MS = 10000, LOST_AFTER_S = 5;
const received = new Map();
let answeredAt = performance.now(), lostAt = 0, lossReason = "";

function showWarning(text) {
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

function replacePart(old, fresh) {
  const focused = old.contains(document.activeElement) ? document.activeElement.id : "";
  const scrollPositions = [...old.querySelectorAll(".scroll")].map(each => [each.id, each.scrollLeft, each.scrollTop]);
  const openDetails = [...old.querySelectorAll("details[open]")].map(each => each.id);
  old.className = fresh.className;
  old.hidden = fresh.hidden;
  old.replaceChildren(...fresh.childNodes);
  showLocalTimes(old);
  for (const [id, left, top] of scrollPositions) document.getElementById(id)?.scrollTo(left, top);
  for (const id of openDetails) document.getElementById(id)?.setAttribute("open", "");
  if (focused) document.getElementById(focused)?.focus({preventScroll: true});
}

function update(text) {
  const fresh = new DOMParser().parseFromString(text, "text/html").getElementById("live");
  const live = document.getElementById("live");
  const parts = [...fresh.querySelectorAll("[data-live]")];
  if (parts.some(part => !document.getElementById(part.id)) ||
      [...live.querySelectorAll("[data-live]")].some(part => !fresh.querySelector("#" + part.id))) {
    location.reload();  // another kind of page: a run has started, or its folder is readable again
    return;
  }
  for (const part of parts) {
    if (received.get(part.id) === part.outerHTML) continue;
    received.set(part.id, part.outerHTML);
    replacePart(document.getElementById(part.id), part);
  }
  Object.assign(live.dataset, fresh.dataset);
  document.title = fresh.dataset.title;
  answeredAt = performance.now();
}

function showAge() {
  const now = performance.now(), live = document.getElementById("live").dataset;
  const lostS = lostAt ? (now - lostAt) / 1000 : 0, age = Number(live.ageS) + (now - answeredAt) / 1000;
  if (lostS > LOST_AFTER_S) {
    showWarning(`▲ No answer from the monitor for ${Math.round(lostS)} s (${lossReason}). The page below is out of date.`);
    document.title = `▲ no answer: ${live.title}`;
  } else {
    showWarning("");
  }
  const ageLine = document.getElementById("age");
  if (ageLine) ageLine.textContent = live.over === "yes" ? "" : `Snapshot ${Math.round(age)} s old.`;
}

async function poll() {
  try {
    const reply = await fetch("fragment", {cache: "no-store", signal: AbortSignal.timeout(TIMEOUT_MS)});
    if (!reply.ok) throw new Error(`status ${reply.status} ${reply.statusText}`);
    update(await reply.text());
    lostAt = 0;
  } catch (error) {
    lostAt ||= performance.now();
    lossReason = error.message;
  }
  const isOver = document.getElementById("live").dataset.over === "yes";
  setTimeout(poll, isOver && !lostAt ? POLL_WHEN_OVER_MS : POLL_MS);
}

for (const part of document.querySelectorAll("[data-live]")) received.set(part.id, part.outerHTML);
showLocalTimes(document);
document.title = document.getElementById("live").dataset.title;
setInterval(showAge, 1000);
setTimeout(poll, POLL_MS);
