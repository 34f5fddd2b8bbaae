// Controls over the picture: cameras, follow, layers.
import { button, icon, make } from "../dom.ts";
import type { Stage } from "../scene/stage.ts";

const LAYERS = "M12 4l9 5-9 5-9-5zM3 14l9 5 9-5";
const FOLLOW = "M12 8a4 4 0 100 8 4 4 0 000-8zM12 3v3M12 18v3M3 12h3M18 12h3";

export class Hud {
  readonly element: HTMLElement;
  private readonly cameras: HTMLButtonElement[];
  private readonly following: HTMLButtonElement;

  constructor(
    private readonly stage: Stage,
    private readonly follow: (() => void) | null,
  ) {
    const { viewpoint } = stage;
    this.cameras = viewpoint.names.map((name, index) => {
      const camera = button(`Camera ${name} (${index + 1})`, "pv-camera", () => viewpoint.look(name), make("span", "", name));
      camera.dataset.name = name;
      return camera;
    });
    this.following = button("Follow the hand (f)", "pv-icon pv-follow", () => this.follow?.(), icon(FOLLOW));
    this.following.hidden = follow === null;
    this.element = make("div", "pv-hud", make("div", "pv-cameras", ...this.cameras), make("div", "pv-tools", this.following, this.menu()));
    this.update();
  }

  /** Show which camera is active, and whether it follows the hand. */
  update(): void {
    const { name, following } = this.stage.viewpoint;
    this.cameras.forEach((camera) => camera.setAttribute("aria-pressed", String(camera.dataset.name === name)));
    this.following.setAttribute("aria-pressed", String(following));
  }

  private menu(): HTMLElement {
    const rows = this.stage.layers.map((layer) => {
      const box = make("input");
      box.type = "checkbox";
      box.checked = true;
      box.dataset.layer = layer.key;
      box.addEventListener("change", () => this.stage.toggle(layer, box.checked));
      const swatch = make("i", `pv-swatch pv-swatch-${layer.key}`);
      return make("label", "", box, swatch, make("span", "", layer.name));
    });
    const summary = make("summary", "pv-icon", icon(LAYERS));
    summary.title = "Layers";
    summary.setAttribute("aria-label", "Layers");
    return make("details", "pv-layers", summary, make("div", "", ...rows));
  }
}
