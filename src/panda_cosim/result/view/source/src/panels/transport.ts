// Play, scrub, speed; events of the run above the timeline.
import { type Clock, SPEEDS } from "../clock.ts";
import type { Mark } from "../data/types.ts";
import { button, icon, make } from "../dom.ts";

const PLAY = "M8 5.5v13l11-6.5z";
const PAUSE = "M7.5 5.5h3v13h-3zM13.5 5.5h3v13h-3z";
const BACK = "M17 6.5v11l-8-5.5zM6.5 6.5h2v11h-2z";
const NEXT = "M7 6.5v11l8-5.5zM15.5 6.5h2v11h-2z";
const CROWDED = 46; // [px] that a label needs

export function transport(clock: Clock, moments: readonly Mark[]): HTMLElement {
  const play = button("Play or pause (space)", "pv-play", () => clock.toggle(), icon(PLAY));
  const back = button("One step back (,)", "pv-step", () => clock.step(-1), icon(BACK));
  const next = button("One step forward (.)", "pv-step", () => clock.step(1), icon(NEXT));
  const reading = make("output", "pv-clock");
  const element = make("footer", "pv-transport", back, play, next, track(clock, moments), reading, speeds(clock));
  clock.onTime((time) => (reading.textContent = `${time.toFixed(3)} s`));
  clock.onState(() => {
    play.replaceChildren(icon(clock.playing ? PAUSE : PLAY));
    play.setAttribute("aria-pressed", String(clock.playing));
  });
  return element;
}

function track(clock: Clock, moments: readonly Mark[]): HTMLElement {
  const slider = make("input", "pv-scrub");
  slider.type = "range";
  slider.step = "any";
  slider.setAttribute("aria-label", "Time");
  slider.addEventListener("input", () => clock.seek(Number(slider.value)));
  clock.onState(() => {
    [slider.min, slider.max] = clock.span.map(String);
  });
  const share = (time: number) => (time - clock.span[0]) / (clock.span[1] - clock.span[0] || 1);
  clock.onTime((time) => {
    slider.value = String(time);
    slider.style.setProperty("--share", String(share(time)));
    slider.setAttribute("aria-valuetext", `${time.toFixed(3)} s`);
  });
  const marks = make("div", "pv-marks");
  for (const { time, label } of moments) {
    const mark = button(`${label}, ${time.toFixed(2)} s`, "pv-mark", () => clock.seek(time), make("span", "", label));
    mark.style.left = `${100 * share(time)}%`;
    marks.append(mark);
  }
  new ResizeObserver(() => thinOut(marks)).observe(marks);
  return make("div", "pv-track", marks, slider);
}

/** Hide labels that would overlap the one before; their ticks stay. */
function thinOut(marks: HTMLElement): void {
  let last = -Infinity;
  for (const mark of marks.children as Iterable<HTMLElement> & HTMLCollection) {
    const place = (mark as HTMLElement).offsetLeft;
    mark.classList.toggle("pv-mute", place - last < CROWDED);
    if (place - last >= CROWDED) last = place;
  }
}

function speeds(clock: Clock): HTMLElement {
  const select = make("select", "pv-speed");
  select.setAttribute("aria-label", "Speed");
  for (const speed of SPEEDS) {
    const option = make("option", "", `${speed}×`);
    option.value = String(speed);
    select.append(option);
  }
  select.addEventListener("change", () => (clock.speed = Number(select.value)));
  clock.onState(() => (select.value = String(clock.speed)));
  return select;
}
