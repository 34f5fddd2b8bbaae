// Runs the page's code, which stands in it deflated, one bundle after the other.
import { inflate } from "./data/codec.ts";

async function load(): Promise<void> {
  for (const element of document.querySelectorAll("script[data-code]")) {
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(await inflate(element.textContent!));
    document.head.append(script);
    script.remove();
  }
  dispatchEvent(new Event("code-ready"));
}

void load();
