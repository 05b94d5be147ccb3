// The list of state changes: when, which state, why. Draws what it is given.

const rows = document.querySelector("#changes ol");
let drawn = "", marked = -1;

function part(name, text) {
  const made = document.createElement("span");
  made.className = name;
  made.textContent = text;
  return made;
}

function row(change, when, pick) {
  const item = document.createElement("li"), whole = document.createElement(pick ? "button" : "div");
  item.dataset.state = change.state;
  whole.append(part("when", when(change.at)), part("which", change.state), part("why", change.reason));
  if (pick) whole.addEventListener("click", () => pick(change.at));
  item.append(whole);
  return item;
}

// `when(at)` gives a time's text; `pick(at)`, if given, is called for the change that is clicked.
export function list(changes, when, pick) {
  const text = JSON.stringify(changes);
  if (text === drawn) return;
  [drawn, marked] = [text, -1];
  rows.replaceChildren(...changes.map((one) => row(one, when, pick)));
}

// Show which change is the present one, and bring it into view without moving the page.
export function mark(index) {
  if (index === marked) return;
  rows.children[marked]?.removeAttribute("aria-current");
  const item = rows.children[(marked = index)];
  item?.setAttribute("aria-current", "true");
  if (item) rows.scrollTop = item.offsetTop - rows.offsetTop - (rows.clientHeight - item.offsetHeight) / 2;
}
