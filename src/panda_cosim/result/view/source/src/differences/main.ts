// Entry point of the reports on differences: figures, sections that unfold, and runs in 3D.
import "uplot/dist/uPlot.min.css";
import "./style.css";
import { Curve } from "./curve.ts";
import { Figure } from "./figure.ts";

declare global {
  /** The page's other code, if it shows runs in 3D. */
  const PandaView: typeof import("../main.ts");
}

const AHEAD = "600px"; // a figure is drawn before it is scrolled into view

export const figures = new Map<HTMLElement, Figure>();
const all = <T extends HTMLElement>(selector: string): T[] => [...document.querySelectorAll<T>(selector)];

function show(host: HTMLElement): void {
  if (!figures.has(host)) figures.set(host, new Figure(host, new Curve(JSON.parse(host.dataset.curve!))));
}

/** Draw figures in view at once, since the observer reports only after the first frame, and others later. */
function drawFigures(): void {
  const watcher = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting) continue;
      watcher.unobserve(target);
      show(target as HTMLElement);
    }
  }, { rootMargin: AHEAD });
  for (const host of all(".chart")) {
    if (!host.closest("details:not([open])") && host.getBoundingClientRect().top < innerHeight) show(host);
    else watcher.observe(host);
  }
  addEventListener("beforeprint", () => all("details[open] .chart").forEach(show));
  const redraw = () => figures.forEach((figure) => figure.redraw());
  for (const media of ["(prefers-color-scheme: dark)", "print"]) matchMedia(media).addEventListener("change", redraw);
}

/** Unfold the section that the address names. */
function unfold(): void {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!(target instanceof HTMLDetailsElement)) return;
  target.open = true;
  target.scrollIntoView();
}

/** Runs in 3D: one viewer at a time replaces its button; that of the worst scenario opens by itself. */
class Views {
  private restore = (): void => undefined;
  private ready = Promise.resolve();

  constructor() {
    for (const host of all(".view")) host.querySelector("button")!.addEventListener("click", () => this.open(host));
    const worst = document.querySelector<HTMLElement>(".scenario:not(.good) .view");
    if (worst) addEventListener("code-ready", () => this.open(worst), { once: true });
  }

  private open(host: HTMLElement): void {
    this.ready = this.ready.then(() => this.show(host));
  }

  private async show(host: HTMLElement): Promise<void> {
    const button = host.querySelector(":scope > button");
    if (!button) return; // it is open
    const before = this.restore;
    this.restore = () => {
      host.className = "view tools";
      host.replaceChildren(button);
    };
    host.className = "view open";
    button.remove();
    try {
      await PandaView.show(JSON.parse(host.dataset.runs!), { at: Number(host.dataset.at), into: host });
    } catch (error) {
      this.restore();
      button.textContent = `No 3D here: ${error instanceof Error ? error.message : String(error)}`;
    }
    before(); // restores the button of the viewer that was closed
  }
}

drawFigures();
new Views();
addEventListener("hashchange", unfold);
for (const link of all("#verdicts a")) link.addEventListener("click", () => setTimeout(unfold));
unfold();
