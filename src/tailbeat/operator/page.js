// The operator's page: hears snapshots, shows them, sends orders. It decides nothing.
// Behind it is a station with a fish, or the log of a finished run.

import { list, mark } from "./changes.js";
import { plot } from "./distance.js";
import { draggable, draw, resting } from "./map.js";
import { answered as replayed, open, seek, toggle } from "./replay.js";

const SILENT = 1.0; // s without a word from the fish, or from the station
const MOVES = 50; // ms between two places of a dragged target
const SLACK = 0.15; // s that a status may be old without the pose being older
const ICONS = {
  none: "M4 10h4v4H4zM10 10h4v4h-4zM16 10h4v4h-4z",
  disarmed: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zm0 3a6 6 0 1 1 0 12 6 6 0 0 1 0-12z",
  armed: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zm0 3a6 6 0 0 1 0 12z",
  test: "M4 12l2-2 3 3 9-9 2 2L9 17z",
  run: "M6 3l15 9-15 9z",
  hold: "M5 3h5v18H5zM14 3h5v18h-5z",
  stop: "M7.5 2h9L22 7.5v9L16.5 22h-9L2 16.5v-9z",
};
const TORQUE = ["armed", "test", "run", "hold"]; // states with torque
const byId = (id) => document.getElementById(id);
const body = document.body;
let socket = null, now = null, heard = 0, may = false, stopping = 0, pictures = false;
let replay = null; // the run that is replayed, or null with a fish
const given = () => new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
let token = given(), told = null; // told: number of the last outcome shown

// ---- what goes out ----

function send(command) {
  if (socket?.readyState !== WebSocket.OPEN) return say("not sent: no connection to the station", true);
  socket.send(JSON.stringify({ token, ...command }));
}

function stop() {
  if (replay) return; // there is nothing to stop
  stopping = performance.now() + 3000;
  sendStop(() => say("STOP not sent: no connection to the station", true));
}

// A socket that has been silent may be open and yet hold back what is sent: STOP goes both ways then.
function sendStop(failed) {
  const open = socket?.readyState === WebSocket.OPEN;
  if (open) socket.send('{"do": "stop"}');
  if (!open || performance.now() - heard > 1000 * SILENT) fetch("stop", { method: "POST" }).catch(failed);
}

// An order to stop that the fish has not followed is sent again.
const moving = () => TORQUE.includes(now?.status?.state);
setInterval(() => {
  if (performance.now() > stopping || !moving()) return;
  sendStop(() => {});
}, 300);

let waiting = null, sentAt = 0;
function aim(at) {
  const wait = sentAt + MOVES - performance.now();
  clearTimeout(waiting);
  if (wait > 0) { waiting = setTimeout(() => aim(at), wait); return; }
  sentAt = performance.now();
  send({ do: "target", at });
}

byId("stop").addEventListener("click", stop);
document.addEventListener("keydown", (event) => {
  if (event.code !== "Space") return;
  event.preventDefault(); // it presses no other button
  if (event.repeat) return;
  if (replay) toggle();
  else stop();
}, true);
document.addEventListener("keyup", (event) => { if (event.code === "Space") event.preventDefault(); }, true);
for (const order of ["arm", "swim", "disarm", "tag"]) byId(order).addEventListener("click", () => send({ do: order }));
byId("key").addEventListener("submit", (event) => {
  event.preventDefault();
  token = byId("token").value.trim();
  send({ do: "hello" });
});
// The address with a token, pasted over the open page, does not load it again.
window.addEventListener("hashchange", () => {
  if (!given()) return;
  token = given();
  if (socket?.readyState === WebSocket.OPEN) send({ do: "hello" });
});
draggable(aim, () => may);

// ---- what comes in ----

// Answers to this page, with what became of its orders, have one line, and the orders of other pages
// another: a refusal stays until this page asks again.
function say(text, bad = false, line = "said") {
  byId(line).textContent = text;
  byId(line).classList.toggle("bad", bad);
}

function answered(text) {
  if (text === "token accepted") may = true;
  if (text.startsWith("refused: wrong token")) may = false;
  say(text, text.startsWith("refused"));
  entitle();
}

// What became of orders since the last snapshot; those before this page was open are old news.
function outcomes(all, you) {
  const last = all.at(-1)?.number ?? 0;
  if (told === null || last < told) told = last; // the page or the station is new
  for (const one of all.filter(({ number }) => number > told)) {
    if (one.asker === you) say(one.text, one.bad);
    else say(`${one.asker ? "another page" : "the station"}: ${one.text}`, one.bad, "sent");
  }
  told = last;
}

function entitle() {
  byId("key").hidden = may || Boolean(replay);
  body.classList.toggle("watching", !may);
}

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.addEventListener("open", () => { if (token) send({ do: "hello" }); });
  socket.addEventListener("message", ({ data }) => {
    const message = JSON.parse(data);
    heard = performance.now();
    pictures = message.camera;
    message.said.forEach(answered);
    if (message.replay) rerun(message.replay);
    if (message.now) show(message.now);
    if (message.now) outcomes(message.now.outcomes, message.you);
    if (replay) replayed();
    else socket.send("drawn");
  });
  socket.addEventListener("close", () => setTimeout(connect, 1000));
}

// A log is behind the page: a player instead of orders.
function rerun(run) {
  replay = run;
  may = false;
  body.classList.add("replay");
  document.title = `${run.name} · tailbeat`;
  byId("player").hidden = byId("replayed").hidden = false;
  byId("replayed").textContent = `replay of ${run.name}${run.whole ? "" : " · incomplete log"}`;
  byId("stop").disabled = true;
  byId("what").textContent = "not in a replay: no fish is connected";
  say("A replay takes no orders: no fish is connected.");
  list(run.changes, seconds, seek);
  open(run, (at) => { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ do: "at", at })); });
  entitle();
}

const seconds = (at) => `${at.toFixed(1)} s`;
const timeOfDay = (at) => new Date(1000 * at).toLocaleTimeString("en-GB");

function show(snapshot) {
  now = snapshot;
  if (!moving()) stopping = 0; // it has followed; a fish that is armed again is not stopped again
  draw(now);
  plot(now);
  if (replay) mark(replay.changes.findLastIndex((one) => one.at <= now.at));
  else list(now.changes.toReversed(), timeOfDay);
  state();
  gauges();
}

// ---- state ----

function state() {
  const status = now?.status;
  const cut = performance.now() - heard > 1000 * SILENT;
  const silent = cut || !status || status.age > SILENT;
  body.dataset.state = status?.state ?? "none";
  body.classList.toggle("silent", silent);
  byId("icon").setAttribute("d", ICONS[status?.state ?? "none"]);
  byId("state").textContent = status?.state ?? "no fish";
  byId("reason").textContent = cut ? `no connection to the ${replay ? "replay" : "station"}: these are the last values`
    : !status ? "the fish has not answered yet"
    : silent ? `nothing from the fish for ${status.age.toFixed(1)} s; it was: ${status.reason}` : status.reason;
  countdown(status);
  const may_ = (order, ...states) => { byId(order).disabled = !may || !states.includes(status?.state); };
  may_("arm", "disarmed", "hold");
  may_("swim", "armed");
  may_("disarm", ...TORQUE, "stop");
  byId("tag").disabled = !may || !now?.operator;
  byId("where").textContent = where();
}
setInterval(state, 250);

function where() {
  const moves = resting(now?.velocity) ? "" : `, moves at ${Math.hypot(...now.velocity).toFixed(2)} m/s`;
  const at = now?.target && `at x ${now.target[0].toFixed(2)}, y ${now.target[1].toFixed(2)} m${moves}`;
  if (replay) return at ? `target ${at}` : "no target: the log holds it while the fish swims";
  return at ? `target ${now.operator ? "by hand" : "by its tag"} ${at}` : "no target seen: drag it to a place in the pool";
}

// What follows where no new pose comes, and at which age [s] of the last: HOLD while the fish moves.
function ends(status) {
  if (!TORQUE.includes(status?.state)) return undefined;
  return ["test", "run"].includes(status.state) ? ["HOLD", status.pose_hold] : ["STOP", status.pose_stop];
}

const poseAge = (status) => (status.pose_age ?? Infinity) + Math.max(status.age - SLACK, 0);

function countdown(status) {
  const limit = ends(status);
  const left = limit ? limit[1] - poseAge(status) : Infinity;
  byId("countdown").hidden = !(left < 0.6 * limit?.[1]);
  if (limit) byId("countdown").textContent = `no new pose: ${limit[0]} in ${Math.max(left, 0).toFixed(1)} s`;
}

// ---- readings ----

const known = (value) => value !== null && value !== undefined;
const number = (value, digits, unit) => (!known(value) ? "–" : `${value.toFixed(digits)} ${unit}`);
const ms = (value, digits = 1) => (Number.isFinite(value) ? `${(1000 * value).toFixed(digits)} ms` : "–");
const percent = (value) => (!known(value) ? "–" : `${(100 * value).toFixed(value < 0.1 ? 1 : 0)} %`);
const degrees = (value) => (!known(value) ? "–" : `${(value * 180 / Math.PI).toFixed(0)}°`);

// Name, text, part of a bar that is full (or nothing), whether to warn.
function readings(status, limits) {
  const age = poseAge(status), hold = status.pose_hold;
  const [what, when] = ends(status) ?? [];
  const lost = Math.max(status.loss ?? 0, now.loss_back ?? 0);
  const volts = status.voltage, [low, high] = [limits.voltage_low, limits.voltage_high];
  return [
    ["Pose age", ms(age, 0) + (what ? ` · ${what} at ${ms(when, 0)}` : ""), age / hold, age > 0.5 * hold],
    ["Poses lost, status lost", replay ? "–" : `${percent(status.loss)}, ${percent(now.loss_back)}`, lost, lost > 0.3],
    ["Loop late, longest", ms(status.late), status.late / 0.02, status.late > 0.005],
    ["Loop busy, longest", ms(status.busy), status.busy / 0.02, status.busy > 0.015],
    ["Periods missed", `${status.missed ?? "–"} in the last second`, status.missed / limits.overruns_hold, status.missed > 0],
    ["Beat inside the band", percent(status.band_share), status.band_share, status.band_share !== null && status.band_share < 0.8],
    ["Servo temperature", number(status.temperature, 0, "°C"), status.temperature / limits.temperature_stop, status.temperature >= limits.temperature_hold - 10],
    ["Servo voltage", number(volts, 1, "V"), (volts - low) / (high - low), volts !== null && (volts < low + 0.5 || volts > high - 0.5)],
    ["Servo current", number(status.current, 2, "A"), Math.abs(status.current) / limits.current_stop, Math.abs(status.current) > limits.current_stop / 2],
    ["Clock error, at most", ms(status.clock_doubt), status.clock_doubt / limits.clock_doubt, !known(status.clock_doubt) || status.clock_doubt > limits.clock_doubt / 2],
    ["Motor → setpoint", `${degrees(status.angle)} → ${degrees(status.setpoint)}`, undefined, false],
    ["Datagrams rejected", `${status.rejects ?? "–"}`, undefined, status.rejects > 0],
  ];
}

function gauges() {
  if (!now.status) return;
  const list = document.querySelector("#gauges dl");
  readings(now.status, now.limits).forEach(([name, text, part, warn], k) => {
    const row = list.children[k] ?? list.appendChild(gauge(name, part !== undefined));
    row.classList.toggle("warn", Boolean(warn));
    row.children[1].textContent = text;
    if (row.children[2]) row.querySelector("i").style.width = `${100 * Math.min(Math.max(part || 0, 0), 1)}%`;
  });
}

function gauge(name, barred) {
  const row = document.createElement("div");
  row.className = "gauge";
  const [label, value, bar] = ["dt", "dd", "dd"].map((tag) => document.createElement(tag));
  label.textContent = name;
  bar.className = "bar";
  bar.appendChild(document.createElement("i"));
  row.append(label, value, ...(barred ? [bar] : []));
  return row;
}

// ---- camera ----

const camera = byId("camera");
function look() {
  byId("dark").textContent = now?.note || "No camera picture.";
  if (!pictures) { camera.hidden = true; byId("dark").hidden = false; setTimeout(look, 500); return; }
  camera.src = `camera.jpg?${Math.round(performance.now())}`;
}
camera.addEventListener("load", () => { camera.hidden = false; byId("dark").hidden = true; setTimeout(look, 100); });
camera.addEventListener("error", () => setTimeout(look, 1000));

entitle();
connect();
look();
