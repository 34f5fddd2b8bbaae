// Rendering quality: full with a GPU, reduced with software rendering.

export interface Quality {
  antialias: boolean;
  pixelRatio: number;
  shadowSide: number; // [px] of the shadow map
  reflections: boolean;
  anisotropy: number;
}

const FULL: Quality = { antialias: true, pixelRatio: 2, shadowSide: 2048, reflections: true, anisotropy: 8 };
const PLAIN: Quality = { antialias: true, pixelRatio: 1, shadowSide: 1024, reflections: false, anisotropy: 1 };
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** Choose the quality by the name of the renderer. */
export function quality(): Quality {
  const context = document.createElement("canvas").getContext("webgl2", { antialias: false });
  if (!context) return PLAIN;
  const told = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : context.RENDERER));
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(name) ? PLAIN : FULL;
}
