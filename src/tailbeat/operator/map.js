// The pool from above: metres, x to the right, y upwards. Draws what it is given, and lets the target be dragged.

const TRAIL = 30_000; // ms that the fish's path stays
const FINGER = 24; // px: half of what a finger needs
const NEWS = 1000; // ms that an operator's own move goes over a snapshot, which may be older
const STEP = 0.05; // m for an arrow key
const EDGE = 0.12; // m around the pool
const SLOW = 0.02; // m/s below which a target rests: its tag is seen with noise
const AHEAD = 2; // s of the target's motion that its arrow shows
const HEAD = 0.06; // m, length of the arrow's head
const map = document.getElementById("map");
const target = document.getElementById("target");
let path = []; // places x, y [m] with the time [ms] at which the fish was there, oldest first
let room = null, held = null, last = null, moved = -Infinity;

const element = (name, attributes) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
};
const set = (id, attributes) => {
  for (const [key, value] of Object.entries(attributes)) document.getElementById(id).setAttribute(key, value);
};

function drawPool([length, width]) {
  room = [length, width];
  const [x, y] = [length / 2, width / 2];
  map.setAttribute("viewBox", `${-x - EDGE} ${-y - EDGE} ${length + 2 * EDGE} ${width + 2 * EDGE}`);
  const parts = [element("rect", { x: -x, y: -y, width: length, height: width, rx: 0.04 })];
  for (let at = -Math.floor(2 * x) / 2; at <= x; at += 0.5) parts.push(element("line", { x1: at, x2: at, y1: -y, y2: y }));
  for (let at = -Math.floor(2 * y) / 2; at <= y; at += 0.5) parts.push(element("line", { x1: -x, x2: x, y1: at, y2: at }));
  for (let at = -Math.floor(x); at <= x; at++) {
    const label = element("text", { x: at, y: y - 0.05 });
    label.textContent = `${at} m`;
    parts.push(label);
  }
  document.getElementById("pool").replaceChildren(...parts);
  fingers();
}

// The place that takes a finger has the same size on every screen.
function fingers() {
  if (!room) return;
  const metre = map.getScreenCTM()?.a ?? 1; // px
  target.querySelector(".touch").setAttribute("r", Math.max(0.15, FINGER / Math.max(metre, 1)));
}
new ResizeObserver(fingers).observe(map);

// Along one flank and back along the other; `body` holds x, y, half width from nose to fin.
function flanks(body) {
  const side = (sign) => body.map(([x, y, half], k) => {
    const [a, b] = [body[Math.max(k - 1, 0)], body[Math.min(k + 1, body.length - 1)]];
    const long = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1;
    return [x - (sign * half * (b[1] - a[1])) / long, -(y + (sign * half * (b[0] - a[0])) / long)];
  });
  return rounded([...side(1), ...side(-1).reverse()]);
}

// A closed curve through the middles of the edges, bent by the corners.
function rounded(corners) {
  const middle = ([x, y], [u, v]) => `${((x + u) / 2).toFixed(4)} ${((y + v) / 2).toFixed(4)}`;
  const next = (k) => corners[(k + 1) % corners.length];
  const curves = corners.map((corner, k) => `Q${corner[0].toFixed(4)} ${corner[1].toFixed(4)} ${middle(corner, next(k))}`);
  return `M${middle(corners.at(-1), corners[0])}${curves.join("")}Z`;
}

function drawFish(fish) {
  document.getElementById("fish").classList.toggle("old", fish.age > 0.3);
  set("fish", { d: flanks(fish.body) });
}

// A live fish's path is what this page saw; a log's comes with each moment, as it may jump in time.
function drawTrail(fish, trail) {
  const now = performance.now();
  if (trail) path = trail.map(([age, x, y]) => ({ time: now - 1000 * age, x, y }));
  else if (fish && fish.age < 0.3 && !(now - path.at(-1)?.time <= 150)) path.push({ time: now, x: fish.pose[0], y: fish.pose[1] });
  while (path.length && now - path[0].time > TRAIL) path.shift();
  const pieces = [];
  for (let k = 0; k + 1 < path.length; k += 20) {
    const piece = path.slice(k, k + 21);
    const points = piece.map(({ x, y }) => `${x.toFixed(3)},${(-y).toFixed(3)}`).join(" ");
    pieces.push(element("polyline", { points, opacity: Math.max(1 - (now - piece.at(-1).time) / TRAIL, 0.1) }));
  }
  document.getElementById("trail").replaceChildren(...pieces);
}

function place([x, y]) {
  target.setAttribute("transform", `translate(${x} ${-y})`);
  target.setAttribute("aria-valuetext", `x ${x.toFixed(2)}, y ${y.toFixed(2)} metres`);
}

// An arrow in the target's own frame: where it will be in two seconds.
function arrow([u, v]) {
  const speed = Math.hypot(u, v);
  if (speed < SLOW) return "";
  const [x, y, c, s] = [AHEAD * u, -AHEAD * v, (HEAD * u) / speed, (-HEAD * v) / speed];
  const back = (side) => `L${(x - c - side * s).toFixed(3)} ${(y - s + side * c).toFixed(3)}`;
  const tip = `${x.toFixed(3)} ${y.toFixed(3)}`;
  return `M0 0L${tip}${back(1)}M${tip}${back(-1)}`;
}

export const resting = (velocity) => !velocity || Math.hypot(...velocity) < SLOW;

export function draw(now) {
  if (!room || room[0] !== now.room[0] || room[1] !== now.room[1]) drawPool(now.room);
  if (now.fish) drawFish(now.fish);
  else if (now.trail) set("fish", { d: "" }); // at this time of the log no pose was known
  if (now.fish || now.trail) drawTrail(now.fish, now.trail);
  if (performance.now() - moved > NEWS) last = now.target ?? last ?? [0, 0];
  target.classList.toggle("ghost", !now.target);
  target.toggleAttribute("hidden", Boolean(now.trail) && !now.target); // nobody can drag one there
  if (!held) place(last);
  set("motion", { d: now.target && now.velocity ? arrow(now.velocity) : "" });
  const aim = now.status?.target;
  document.getElementById("aim").toggleAttribute("hidden", !aim);
  if (aim) set("aim", { cx: aim[0], cy: -aim[1] });
  const nose = now.fish?.body[0];
  set("way", { d: aim && nose ? `M${nose[0]} ${-nose[1]}L${aim[0]} ${-aim[1]}` : "" });
}

// `tell([x, y])` is called where the operator puts the target; `may()` says whether he may.
export function draggable(tell, may) {
  const inside = (at, half) => Math.min(Math.max(at, -half), half);
  const there = (event) => {
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(map.getScreenCTM().inverse());
    return [inside(x, room[0] / 2), inside(-y, room[1] / 2)];
  };
  const put = (at) => { last = at; moved = performance.now(); place(at); tell(at); };
  target.addEventListener("pointerdown", (event) => {
    if (!may() || !room) return;
    event.preventDefault();
    held = event.pointerId;
    target.setPointerCapture(held);
    target.classList.add("held");
  });
  // Else a finger scrolls the page, and the drag is cancelled: `touch-action` does not hold in an SVG.
  target.addEventListener("touchstart", (event) => { if (may()) event.preventDefault(); }, { passive: false });
  target.addEventListener("pointermove", (event) => { if (event.pointerId === held) put(there(event)); });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
    target.addEventListener(end, (event) => {
      if (event.pointerId !== held) return;
      held = null;
      target.classList.remove("held");
    });
  }
  target.addEventListener("keydown", (event) => {
    const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [];
    if (x === undefined || !may() || !room) return;
    event.preventDefault();
    put([inside(last[0] + STEP * x, room[0] / 2), inside(last[1] + STEP * y, room[1] / 2)]);
  });
}
