// Light or dark colours: as the documentation site around a page has them, else as the system does.

const system = matchMedia("(prefers-color-scheme: dark)");

/** What carries the colours of the site that shows this page in a frame; null: there is none. */
function around(): HTMLElement | null {
  try {
    return parent === window ? null : parent.document.querySelector<HTMLElement>("[data-md-color-scheme]");
  } catch {
    return null; // of another origin
  }
}

export function isDark(): boolean {
  const site = around();
  return site ? site.dataset.mdColorScheme === "slate" : system.matches;
}

/** Tell of changes; returns what ends it. */
export function onScheme(tell: () => void): () => void {
  const site = around(), watch = new MutationObserver(tell);
  if (site) watch.observe(site, { attributes: true, attributeFilter: ["data-md-color-scheme"] });
  system.addEventListener("change", tell);
  return () => {
    watch.disconnect();
    system.removeEventListener("change", tell);
  };
}
