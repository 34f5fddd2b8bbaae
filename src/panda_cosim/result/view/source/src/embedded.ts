// Data that a page carries, as JSON in elements that no browser runs.

/** Return the JSON of a page's element by its name, which is JSON as well, or null. */
export function embedded(name: string): unknown {
  const elements = document.querySelectorAll<HTMLScriptElement>("script[data-view]");
  const found = Array.from(elements).find((element) => JSON.parse(element.dataset.view!) === name);
  return found ? JSON.parse(found.textContent ?? "null") : null;
}
