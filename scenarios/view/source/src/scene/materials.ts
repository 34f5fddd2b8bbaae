// Colours, gloss and textures of the model.
import { Color, type Material, MeshStandardMaterial, RepeatWrapping, SRGBColorSpace, Texture } from "three";
import type { ShapeData } from "../data/types.ts";

/** Decode the model's textures (PNG); null for one that fails. */
export async function loadTextures(images: readonly string[], anisotropy: number): Promise<(Texture | null)[]> {
  const loading = images.map(async (image) => {
    const bytes = Uint8Array.from(atob(image), (c) => c.charCodeAt(0));
    const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/png" }), { imageOrientation: "flipY" });
    const texture = new Texture(bitmap);
    texture.flipY = false; // the bitmap is already flipped
    texture.wrapS = texture.wrapT = RepeatWrapping;
    texture.colorSpace = SRGBColorSpace;
    texture.anisotropy = anisotropy;
    texture.needsUpdate = true;
    return texture;
  });
  const done = await Promise.allSettled(loading);
  return done.map((result) => (result.status === "fulfilled" ? result.value : null));
}

/** Return a shape's material. */
export function shapeMaterial(shape: ShapeData, textures: readonly (Texture | null)[]): MeshStandardMaterial {
  const [red, green, blue, alpha] = shape.rgba;
  const colour = new Color().setRGB(red, green, blue, SRGBColorSpace);
  const texture = shape.texture === undefined ? null : textures[shape.texture];
  return new MeshStandardMaterial({
    color: colour,
    map: texture,
    roughness: 0.62 - 0.35 * (shape.shininess ?? 0.5),
    metalness: 0.02,
    emissive: colour,
    emissiveIntensity: 0.6 * (shape.emission ?? 0),
    transparent: alpha < 1,
    opacity: alpha,
    depthWrite: alpha >= 1,
  });
}

/** Return a ghost's two materials: one writes depth only, so that only the outside shows; one tints. */
export function ghostMaterials(): [Material, Material] {
  const shared = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2 };
  const depth = new MeshStandardMaterial({ ...shared, colorWrite: false });
  const tint = new MeshStandardMaterial({
    ...shared,
    color: 0x2f8cff,
    emissive: 0x1f6fe0,
    emissiveIntensity: 0.25,
    roughness: 0.5,
    transparent: true,
    opacity: 0.42,
    depthWrite: false,
  });
  return [depth, tint];
}
