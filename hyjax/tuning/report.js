"use strict";
// Two pictures at the same place: the first of the pair is shown, the second while the pointer rests on it or after X.
const dialog = document.querySelector("dialog");
const viewers = [];
let active = null;

function viewer(article) {
  const thumbs = [...article.querySelectorAll(".strip img")];
  const names = [...article.querySelectorAll(".strip span")].map((span) => span.textContent);
  const stage = article.querySelector(".stage");
  const large = document.createElement("img");
  const line = document.createElement("p");
  const now = document.createElement("span");
  now.className = "now";
  const choose = (label, chosen) => {
    const select = document.createElement("select");
    names.forEach((name, i) => select.add(new Option(name, i, false, i === Number(chosen))));
    select.onchange = () => self.show(Number(first.value));
    const text = document.createElement("label");
    text.append(label + " ", select);
    line.append(text);
    return select;
  };
  line.append(now);
  const self = { at: 0, count: names.length };
  const first = choose("shown", article.dataset.first);
  const second = choose("under the pointer", article.dataset.second);
  self.show = (i) => {
    self.at = i;
    large.src = thumbs[i].src;
    large.alt = thumbs[i].alt;
    now.textContent = names[i];
    if (dialog.open) {
      const big = large.cloneNode();
      const caption = document.createElement("figcaption");
      caption.textContent = thumbs[i].alt + "   (X: the other, arrows: walk, Esc: back)";
      dialog.firstElementChild.replaceChildren(big, caption);
    }
  };
  self.rest = () => self.show(Number(first.value));
  self.flip = () => self.show(Number(self.at === Number(second.value) ? first.value : second.value));
  self.enlarge = (i) => {
    active = self;
    dialog.showModal();
    self.show(i);
  };
  large.onpointerenter = () => self.show(Number(second.value));
  large.onpointerleave = () => dialog.open || self.rest();
  large.onclick = () => self.enlarge(self.at);
  thumbs.forEach((thumb, i) => {
    const button = thumb.parentElement;
    button.onpointerenter = () => self.show(i);
    button.onpointerleave = () => dialog.open || self.rest();
    button.onclick = () => self.enlarge(i);
  });
  article.onpointerenter = () => { if (!dialog.open) active = self; };
  stage.append(large, line);
  self.rest();
  return self;
}

for (const article of document.querySelectorAll(".example")) viewers.push(viewer(article));
for (const element of document.querySelectorAll(".script")) element.hidden = false;
active = viewers[0];
dialog.onclick = () => dialog.close();
dialog.onclose = () => active.rest();
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (event.key === "x" || event.key === "X") active.flip();
  else if (step && dialog.open) active.show((active.at + step + active.count) % active.count);
  else return;
  event.preventDefault();
});
