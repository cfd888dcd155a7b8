// Small helpers for the document. Text always becomes a text node: no name is ever read as HTML.

/** The element with an id. */
export const $ = (id) => document.getElementById(id);

/** A new element with attributes and children; `on…` are listeners, strings become text. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (typeof value === "boolean") element.toggleAttribute(name, value);
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** Set the text of an element, if it is another one: a live region then speaks only of news. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Hand a file to the person. */
export function download(blob, name) {
  const link = make("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}
