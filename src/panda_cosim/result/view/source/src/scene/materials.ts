// Colours, gloss and textures of the model.
import {
  Color,
  DataTexture,
  LinearFilter,
  LinearMipmapLinearFilter,
  type Material,
  MeshStandardMaterial,
  RepeatWrapping,
  SRGBColorSpace,
  type Texture,
} from "three";
import { inflate } from "../data/codec.ts";
import type { ShapeData, TextureData } from "../data/types.ts";

/** Decode the model's textures. */
export function loadTextures(images: readonly TextureData[], anisotropy: number): Promise<Texture[]> {
  const load = async ({ width, height, pixels }: TextureData): Promise<Texture> => {
    const texture = new DataTexture(await inflate(pixels), width, height);
    texture.wrapS = texture.wrapT = RepeatWrapping;
    texture.magFilter = LinearFilter;
    texture.minFilter = LinearMipmapLinearFilter;
    texture.generateMipmaps = true;
    texture.colorSpace = SRGBColorSpace;
    texture.anisotropy = anisotropy;
    texture.needsUpdate = true;
    return texture;
  };
  return Promise.all(images.map(load));
}

/** Return a shape's material. */
export function shapeMaterial(shape: ShapeData, textures: readonly Texture[]): MeshStandardMaterial {
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
