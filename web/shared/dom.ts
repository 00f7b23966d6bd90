// Elements by function: text is always text, so that nothing of a subject becomes markup.
type Child = Node | string | null | undefined | false;
type Given = Record<string, string | number | boolean | EventListener | undefined>;

function put<E extends Element>(element: E, given: Given, children: Child[]): E {
  for (const [name, value] of Object.entries(given)) {
    if (value === undefined || value === false) continue;
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((child): child is Node | string => child !== null && child !== undefined && child !== false));
  return element;
}

export const h = <K extends keyof HTMLElementTagNameMap>(tag: K, given: Given = {}, ...children: Child[]): HTMLElementTagNameMap[K] =>
  put(document.createElement(tag), given, children);

export const svg = (tag: string, given: Given = {}, ...children: Child[]): SVGElement =>
  put(document.createElementNS("http://www.w3.org/2000/svg", tag), given, children);

export function need<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no part '${id}'`);
  return found as T;
}

export const button = (text: string, act: () => void, given: Given = {}): HTMLButtonElement =>
  h("button", { type: "button", ...given, onclick: () => act() }, text);
