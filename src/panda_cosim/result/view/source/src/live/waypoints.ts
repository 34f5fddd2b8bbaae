// Moves future waypoints with the mouse or a finger; the path changes when they are released.
import { BufferGeometry, Line, LineDashedMaterial, Mesh, MeshBasicMaterial, SphereGeometry, Vector3 } from "three";
import { hint, legible, make } from "../dom.ts";
import type { Stage } from "../scene/stage.ts";
import { Hold } from "./hold.ts";
import type { Plan } from "./link.ts";

const REACH = { mouse: 13, touch: 26 }; // [px] within which a waypoint is grabbed
const COLOUR = 0xf2933a;

type Move = (row: number, place: [number, number, number]) => void;

export class Waypoints extends Hold {
  /** Fields that move waypoints by numbers. */
  readonly element = make("details", "pv-waypoints");
  private plan: Plan = { time: [], points: [], waypoints: [] };
  private now = 0;
  private row = -1;
  private readonly bead = new Mesh(new SphereGeometry(0.011, 20, 14), new MeshBasicMaterial({ color: COLOUR }));
  private readonly line = new Line(new BufferGeometry(), new LineDashedMaterial({ color: COLOUR, dashSize: 0.012, gapSize: 0.008 }));
  private readonly rows: HTMLElement[] = [];

  constructor(
    stage: Stage,
    private readonly bodies: readonly string[], // that can be dragged
    private readonly move: Move,
    private readonly say: (words: string) => void,
  ) {
    super(stage);
    this.bead.visible = this.line.visible = false;
    stage.scene.add(this.bead, this.line);
    stage.element.classList.add("pv-movable");
  }

  /** Show a new plan. */
  use(plan: Plan): void {
    this.plan = plan;
    this.stage.replan();
    this.rows.splice(0, Infinity, ...plan.waypoints.map((_, row) => this.fields(row)));
    this.element.replaceChildren(make("summary", "", make("code", "", "waypoints"), " m"), ...this.rows);
    this.element.hidden = !this.rows.length;
    this.show(this.now);
  }

  /** Set the current time: past waypoints cannot be moved. */
  show(time: number): void {
    this.now = time;
    this.rows.forEach((row, index) => row.toggleAttribute("hidden", !this.isToCome(index)));
  }

  protected take(event: PointerEvent): Vector3 | null {
    const pointer = this.at(event);
    const away = this.plan.waypoints.map(({ place }, row) =>
      this.isToCome(row) ? this.seen(new Vector3(...place)).distanceTo(pointer) : Infinity,
    );
    const nearest = away.indexOf(Math.min(...away));
    if (!(away[nearest] <= (event.pointerType === "mouse" ? REACH.mouse : REACH.touch))) return null;
    const place = new Vector3(...this.plan.waypoints[nearest].place);
    if (event.target instanceof HTMLCanvasElement && this.isHidden(place)) return null;
    this.row = nearest;
    return place;
  }

  protected moveTo(place: Vector3): void {
    this.bead.position.copy(place);
    this.line.geometry.setFromPoints([this.place, place]);
    this.line.computeLineDistances();
    this.bead.visible = this.line.visible = true;
    this.say(`waypoint ${this.plan.waypoints[this.row].label} to ${place.toArray().map((value) => value.toFixed(3)).join(", ")} m`);
    this.stage.refresh();
  }

  protected drop(done: boolean): void {
    if (done && this.bead.visible) this.move(this.row, this.bead.position.toArray());
    this.bead.visible = this.line.visible = false;
    this.row = -1;
  }

  private get place(): Vector3 {
    return new Vector3(...this.plan.waypoints[this.row].place);
  }

  /** Whether a body that can be dragged hides a point. */
  private isHidden(place: Vector3): boolean {
    const [hit] = this.caster.intersectObjects(this.stage.figures[0].bodies, true);
    const isTaken = hit !== undefined && this.bodies.includes(hit.object.parent?.name ?? "");
    return isTaken && hit.distance < place.distanceTo(this.caster.ray.origin);
  }

  private isToCome(row: number): boolean {
    return this.plan.waypoints[row].time > this.now;
  }

  private fields(row: number): HTMLElement {
    const { label, place, time } = this.plan.waypoints[row];
    const fields = place.map((value, axis) => {
      const field = make("input", "pv-field");
      field.type = "number";
      field.step = "0.01";
      field.value = String(Number(value.toFixed(4)));
      field.setAttribute("aria-label", legible(`waypoint ${label}, ${"xyz"[axis]} [m]`));
      field.addEventListener("change", () => {
        const to = fields.map((each) => Number(each.value)) as [number, number, number];
        if (fields.every((each) => each.value !== "")) this.move(row, to);
      });
      return field;
    });
    const name = make("span", "pv-what", label);
    hint(name, `at ${time.toFixed(2)} s`);
    return make("div", "pv-place", name, ...fields);
  }
}
