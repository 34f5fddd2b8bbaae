// The head of the page: scenario, verdict, and name of the ghost.
import type { RunSource } from "../data/source.ts";
import { button, hint, icon, joined, make } from "../dom.ts";

const SUN = "M12 4V2M12 22v-2M4 12H2M22 12h-2M5.6 5.6L4.2 4.2M19.8 19.8l-1.4-1.4M5.6 18.4l-1.4 1.4M19.8 4.2l-1.4 1.4M12 8a4 4 0 100 8 4 4 0 000-8z";

export function header(run: RunSource, ghost: RunSource | null, switchScheme: () => void): HTMLElement {
  const { title, purpose, facts, limits, verdict } = run.about;
  const beyond = limits.some(({ shares }) => shares.some((share) => (share ?? 0) > 1));
  const badge = make("span", `pv-badge pv-${verdict.state === "good" && beyond ? "warn" : verdict.state}`, verdict.words);
  if (beyond) hint(badge, "A limit of the robot was exceeded: see Verdict");
  const about = make("p", "pv-about", ...joined([purpose, ...facts]));
  const top = make("div", "pv-title", make("h1", "", title), badge);
  if (ghost) top.append(make("span", "pv-badge pv-ghost", "ghost: ", ...joined([ghost.name, ghost.about.verdict.words], ", ")));
  const scheme = button("Light or dark colours (d)", "pv-icon", switchScheme, icon(SUN));
  return make("header", "pv-header", make("div", "pv-words", top, about), scheme);
}
