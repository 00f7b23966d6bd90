"""What of a page in a browser's tab an eye, a finger or the Tab key does not reach."""

from __future__ import annotations

SMALLEST_TARGET = 24.0
"""CSS pixels (WCAG 2.2, 2.5.8)."""
COMMON = """
const seen = e => e.checkVisibility({visibilityProperty: true}) && !e.closest('.hidden, .skip');
const name = e => (e.id ? '#' + e.id : e.localName) + ' ' + (e.getAttribute('aria-label') || e.innerText || '').slice(0, 40);
const wanted = 'a[href], button, select, input, textarea, summary, [tabindex="0"]';
const controls = [...document.querySelectorAll(wanted)].filter(e => seen(e) && e.type != 'file');
const round = value => Math.round(10 * value) / 10;
"""  # noqa: E501
COVERED = """
controls.flatMap(e => ['start', 'end'].flatMap(block => {
  if (!e.matches('iframe, .scroll, pre, canvas')) e.scrollIntoView({block});
  const box = e.getClientRects()[0], at = [box.x + box.width / 2, box.y + box.height / 2];
  if (e.matches('.scroll, pre, canvas')) return [];
  const over = document.elementFromPoint(...at);
  return e.contains(over) || over?.closest('label')?.contains(e) ? [] : [`${name(e)} (${block}): ${over ? name(over) : 'outside'}`];
}))
"""  # noqa: E501
CUT = """
(() => {
  const found = [], canvas = document.createElement('canvas').getContext('2d');
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const node = walk.currentNode, e = node.parentElement;
    if (!node.data.trim() || !seen(e) || e.closest('option, svg, script, style, iframe, canvas')) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const box of range.getClientRects()) {
      let scrolls = [false, false];
      for (let a = e; a && a != document.body; a = a.parentElement) {
        const style = getComputedStyle(a), own = a.getBoundingClientRect();
        if (style.display == 'inline' || style.display == 'contents') continue;
        const aside = !scrolls[0] && (box.right > own.right + 1 || box.left < own.left - 1);
        const below = !scrolls[1] && style.overflowY != 'visible' && (box.bottom > own.bottom + 2 || box.top < own.top - 2);
        scrolls = [scrolls[0] || /auto|scroll/.test(style.overflowX), scrolls[1] || /auto|scroll/.test(style.overflowY)];
        if ((aside && !scrolls[0]) || (below && !scrolls[1])) { found.push(`${name(a)}: ${node.data.trim().slice(0, 60)}`); break; }
      }
    }
  }
  for (const e of document.querySelectorAll('input:not([type]), input[type=text], select')) {
    if (!seen(e)) continue;
    const style = getComputedStyle(e), room = e.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight);
    canvas.font = style.font;
    const words = e.localName == 'select' ? (e.selectedOptions[0]?.text ?? '') : e.value || e.placeholder;
    if (canvas.measureText(words).width > room + 1) found.push(`${name(e)}: ${words}`);
  }
  return [...new Set(found)];
})()
"""  # noqa: E501
SMALL = """
controls.flatMap(e => {
  if (e.matches('.scroll, pre, iframe')) return [];
  const style = getComputedStyle(e), sentence = e.parentElement;
  // Links within a sentence are as high as its line (2.5.8, "inline").
  if (e.localName == 'a' && style.display == 'inline' && sentence.innerText.trim().length > e.innerText.trim().length) return [];
  const label = e.closest('label') ?? (e.id ? document.querySelector(`label[for="${e.id}"]`) : null);
  const boxes = [e, ...(e.matches('[type=checkbox], [type=radio]') && label ? [label] : [])].map(one => one.getBoundingClientRect());
  const wide = Math.max(...boxes.map(box => box.width)), high = Math.max(...boxes.map(box => box.height));
  return Math.min(wide, high) < least - 0.01 ? [`${name(e)}: ${round(wide)} x ${round(high)}`] : [];
})
"""  # noqa: E501


def _asked(tab, script):
    return tab.run(f"(() => {{ {COMMON} const least = {SMALLEST_TARGET}; return {script.strip()}; }})()")


def sideways(tab):
    """Pixels by which the page has to be scrolled sideways."""
    return tab.run("document.documentElement.scrollWidth - innerWidth")


def covered(tab):
    """Controls at whose middle something else lies, scrolled to the top of the window and to its bottom."""
    return _asked(tab, COVERED)


def cut(tab):
    """Words that run out of their box, and values that are longer than their field."""
    return _asked(tab, CUT)


def small(tab):
    """Targets below 24 by 24 pixels."""
    return _asked(tab, SMALL)


def unfocused(tab):
    """What is wrong with the place of the focus: nowhere, out of sight, covered, or not outlined; else None."""
    return tab.run(
        """(() => {
        const e = document.activeElement, box = e.getBoundingClientRect();
        if (e == document.body) return 'nowhere';
        const told = (e.id || e.innerText || e.localName).slice(0, 60);
        if (e.localName == 'iframe') return null;
        const style = getComputedStyle(e);
        if (style.outlineStyle == 'none' || parseFloat(style.outlineWidth) < 2) return told + ': no outline';
        const middle = [Math.max(0, box.left) + Math.min(innerWidth, box.right), Math.max(0, box.top) + Math.min(innerHeight, box.bottom)];
        if (box.bottom <= 0 || box.top >= innerHeight || box.right <= 0 || box.left >= innerWidth) return told + ': out of sight';
        const over = document.elementFromPoint(middle[0] / 2, middle[1] / 2);
        return e.contains(over) || over?.closest('label')?.contains(e) ? null : told + ': covered by ' + (over?.id || over?.className || over?.localName);
        })()"""  # noqa: E501
    )
