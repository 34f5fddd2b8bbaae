// Labels in the scene: HTML elements that stay over a point.
import { type Camera, Vector3 } from "three";
import type { RunSource } from "../data/source.ts";
import type { Mark } from "../data/types.ts";
import { hint, make } from "../dom.ts";

export interface Label {
  element: HTMLElement;
  place: Vector3;
}

const SAME = 0.002; // [m] places that are seen as one

/** Waypoints of a run by their place: several may be at the same one. */
export function marksByPlace(run: RunSource): { place: ArrayLike<number>; marks: Mark[] }[] {
  const found: { place: ArrayLike<number>; marks: Mark[] }[] = [];
  for (const mark of run.about.waypoints) {
    const place = mark.place ?? run.at("commanded", mark.time);
    if (!place) continue;
    const near = found.find((spot) => Math.hypot(...[0, 1, 2].map((axis) => spot.place[axis] - place[axis])) < SAME);
    if (near) near.marks.push(mark);
    else found.push({ place, marks: [mark] });
  }
  return found;
}

export class Labels {
  readonly element = make("div", "pv-labels");
  private labels: Label[] = [];
  private readonly spot = new Vector3();

  /** Put text over a point; a click calls the action. */
  add(text: string, place: ArrayLike<number>, words: string, action: () => void): void {
    const element = make("button", "pv-label", text);
    element.type = "button";
    element.tabIndex = -1; // the timeline offers the same to the keyboard
    hint(element, words);
    element.addEventListener("click", action);
    this.labels.push({ element, place: new Vector3(place[0], place[1], place[2]) });
    this.element.append(element);
  }

  /** Remove all labels. */
  clear(): void {
    this.labels = [];
    this.element.replaceChildren();
  }

  /** Move all labels to the screen positions of their points; hide those that would overlap. */
  update(camera: Camera, width: number, height: number): void {
    const taken: [number, number][] = [];
    for (const { element, place } of this.labels) {
      this.spot.copy(place).project(camera);
      const x = ((this.spot.x + 1) / 2) * width;
      const y = ((1 - this.spot.y) / 2) * height;
      const free = taken.every(([otherX, otherY]) => Math.hypot(x - otherX, y - otherY) > 16);
      const seen = free && Math.abs(this.spot.z) < 1 && x > 0 && x < width && y > 0 && y < height;
      element.hidden = !seen;
      if (!seen) continue;
      taken.push([x, y]);
      element.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -50%)`;
    }
  }
}
