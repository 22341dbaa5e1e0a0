/** What is behind the scene, as a picture: light that is refracted has to come from somewhere. */
import { CanvasTexture, SRGBColorSpace } from "three";

const PIXELS = 256;
const CENTER = [0.5, 0.42]; // as in viewer.css
const REACH = [Math.SQRT2 * 0.5, Math.SQRT2 * 0.58]; // to the farthest corner
const EDGE = 0.72;

/** The gradient that the style sheet draws behind the canvas, from one colour to another. */
export function backdrop(inner, outer) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = PIXELS;
  const context = canvas.getContext("2d");
  context.scale(PIXELS, PIXELS);
  context.translate(...CENTER);
  context.scale(...REACH);
  const gradient = context.createRadialGradient(0, 0, 0, 0, 0, 1);
  gradient.addColorStop(0, inner);
  gradient.addColorStop(EDGE, outer);
  context.fillStyle = gradient;
  context.fillRect(-1, -1, 2, 2);
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  return texture;
}
