// The distance of fish and target over the last minute. Draws what it is given.

const SPAN = 60; // s
const EVERY = 200; // ms between two kept distances
const GAP = 1; // s without a distance that leave a hole in the curve
const LEAST = 0.5; // m, smallest height of the plot
const [LEFT, RIGHT, TOP, BOTTOM] = [42, 592, 10, 100]; // of the plot in the picture
const byId = (id) => document.getElementById(id);
let kept = []; // distances [m] with the time [ms] at which they were seen, oldest first
let drawn = 0; // m, height of the scale that is drawn

function element(name, attributes, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

const across = (age) => RIGHT - ((RIGHT - LEFT) * age) / SPAN;
const up = (away, height) => BOTTOM - ((BOTTOM - TOP) * away) / height;

// Lines at nothing, half and all of the height; the ages below.
function scale(height) {
  if (height === drawn) return;
  drawn = height;
  const parts = [0, height / 2, height].flatMap((away) => [
    element("line", { x1: LEFT, x2: RIGHT, y1: up(away, height), y2: up(away, height) }),
    element("text", { class: "left", x: LEFT - 5, y: up(away, height) + 4 }, away ? `${away} m` : "0"),
  ]);
  for (const age of [60, 40, 20]) parts.push(element("text", { x: across(age), y: BOTTOM + 15 }, `−${age} s`));
  parts.push(element("text", { class: "left", x: RIGHT, y: BOTTOM + 15 }, "now"));
  byId("scale").replaceChildren(...parts);
}

// A live fish's distances are what this page saw; a log's come with each moment.
function distances(now) {
  if (now.distances) return now.distances;
  const time = performance.now();
  const known = now.away !== null && now.away !== undefined;
  if (known && !(time - kept.at(-1)?.time < EVERY)) kept.push({ time, away: now.away });
  while (kept.length && time - kept[0].time > 1000 * SPAN) kept.shift();
  return kept.map((one) => [(time - one.time) / 1000, one.away]);
}

export function plot(now) {
  const found = distances(now);
  byId("apart").hidden = !found.length;
  if (!found.length) return;
  const [age, newest] = found.at(-1);
  byId("away").textContent = age > GAP ? "–" : `${newest.toFixed(2)} m`;
  const height = Math.max(LEAST, Math.ceil(2 * Math.max(...found.map(([, away]) => away))) / 2);
  scale(height);
  const pen = (k) => (k && found[k - 1][0] - found[k][0] < GAP ? "L" : "M");
  byId("curve").setAttribute("d", found.map(([old, away], k) => `${pen(k)}${across(old).toFixed(1)} ${up(away, height).toFixed(1)}`).join(""));
}
