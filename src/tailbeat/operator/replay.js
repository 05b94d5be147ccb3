// The player of a finished run: keeps the time, asks for the moment to show, moves its slider.

const FRAME = 33; // ms between two moments, at least
const IDLE = 400; // ms between two questions while it stands still, so that a lost server is noticed
const LOST = 2000; // ms after which an answer comes no more
const byId = (id) => document.getElementById(id);
let run = null, ask = null;
let start = 0, since = 0, playing = false, speed = 1; // at `since` [ms] the time was `start` [s]
let asked = -Infinity, last = null, waiting = false;

const at = () => (playing ? Math.min(start + (speed * (performance.now() - since)) / 1000, run.seconds) : start);

function set(time, play) {
  [start, since, playing] = [Math.min(Math.max(time, 0), run.seconds), performance.now(), play];
  byId("play").textContent = playing ? "Pause" : "Play";
}

export function seek(time) { set(time, playing); }

export function toggle() {
  if (!run) return;
  set(!playing && at() >= run.seconds ? 0 : at(), !playing);
}

// `question(time)` asks for the moment at a time [s]; call `answered` when it came.
export function open(log, question) {
  const again = run?.name === log.name && run.seconds === log.seconds; // the server was away
  [run, ask, waiting, last] = [log, question, false, null];
  byId("time").max = run.seconds;
  if (!again) set(0, false);
}

export function answered() { waiting = false; }

function tick() {
  if (!run) return;
  const now = performance.now();
  if (playing && at() >= run.seconds) set(run.seconds, false);
  const time = at(), news = time !== last;
  if (news) tell(time);
  if (waiting && now - asked < LOST) return;
  if (news || now - asked > IDLE) {
    [asked, last, waiting] = [now, time, true];
    ask(time);
  }
}

function tell(time) {
  const words = `${time.toFixed(1)} of ${run.seconds.toFixed(1)} s`;
  byId("time").value = time;
  byId("time").setAttribute("aria-valuetext", words);
  byId("clock").textContent = words;
}

byId("play").addEventListener("click", toggle);
byId("time").addEventListener("input", ({ target }) => seek(Number(target.value)));
byId("speed").addEventListener("change", ({ target }) => {
  if (run) set(at(), playing); // what was played so far was at the speed before
  speed = Number(target.value);
});
setInterval(tick, FRAME);
