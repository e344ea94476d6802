"""Whether a page can be read, has names for screen readers, and shows what has the keyboard's focus."""

from typing import Any

CONTRASTS = """
() => {
  const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
  const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const luminance = (rgb) => [0.2126, 0.7152, 0.0722].reduce((sum, w, k) => sum + w * linear(rgb[k] / 255), 0);
  const over = (front, back, share) => front.map((v, k) => share * v + (1 - share) * back[k]);
  const ground = (element) => {
    if (!element) return [255, 255, 255];
    const [r, g, b, alpha = 1] = numbers(getComputedStyle(element).backgroundColor);
    return alpha === 1 ? [r, g, b] : over([r, g, b], ground(element.parentElement), alpha);
  };
  const found = [];
  for (const element of document.querySelectorAll("#panel *, #transport *, #notice, #land, #fly, #hint")) {
    const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!own || !element.checkVisibility() || element.matches(":disabled")) continue;
    let opacity = 1;
    for (let at = element; at; at = at.parentElement) opacity *= Number(getComputedStyle(at).opacity);
    const back = ground(element);
    const color = numbers(getComputedStyle(element).color).slice(0, 3);
    const [ink, paper] = [luminance(over(color, back, opacity)), luminance(back)];
    const contrast = (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05);
    if (contrast < 4.5) found.push(`${element.tagName}#${element.id}.${element.className}: ${contrast.toFixed(1)}`);
  }
  return found;
}
"""
"""Texts with too little contrast."""
NAMELESS = """
() => [...document.querySelectorAll("button, input, select, summary, [role=slider], [role=img], canvas")]
  .filter((element) => !element.matches("input[hidden]"))
  .filter((element) => !(element.ariaLabel ?? "").trim() && !element.labels?.length && !element.textContent.trim())
  .map((element) => element.outerHTML.slice(0, 80))
"""
"""Controls and pictures without a name."""
FOCUSED = """
() => {
  const outlined = (element) => {
    const { outlineStyle, outlineWidth } = getComputedStyle(element);
    return outlineStyle !== "none" && outlineWidth !== "0px";
  };
  const { activeElement: found } = document;
  if (found === document.body) return null;
  return [found.outerHTML.slice(0, 80), [found, ...found.children].some(outlined)];
}
"""
"""What has the focus, and whether that is seen."""


def check_legible(page: Any) -> None:
    """Check all that is shown."""
    for wrong in (CONTRASTS, NAMELESS):
        found = page.evaluate(wrong)
        assert not found, found


def check_focus(page: Any) -> int:
    """Go through the page by the Tab key; how many stops there were."""
    page.evaluate("Object.assign(document.body, { tabIndex: -1 }).focus()")  # from the beginning
    page.evaluate("document.body.removeAttribute('tabindex')")
    seen = 0
    page.keyboard.press("Tab")
    while focused := page.evaluate(FOCUSED):
        seen += 1
        assert focused[1], f"not seen to have the focus: {focused[0]}"
        assert seen < 200
        page.keyboard.press("Tab")
    return seen
