/** Numbered, coloured dots in the 3D view, which nothing hides. */
import { CanvasTexture, Group, SRGBColorSpace, Sprite, SpriteMaterial } from "three";

import { markColour } from "./mark_colours.js";

const PIXELS = 64; // of a dot's picture
const DIAMETER = 24; // [px], whatever the distance

/** Dots at points [grid units]. */
export class Marks extends Group {
  /** @param {Array<{at: number[], index: number}>} marks where each is, and whose colour and number it has. */
  set(marks) {
    const same = marks.length === this.children.length && marks.every(({ index }, i) => this.children[i].userData.index === index);
    if (same) return marks.forEach(({ at }, i) => this.children[i].position.set(...at));
    this.dispose();
    for (const { at, index } of marks) this.add(dot(at, index));
  }

  /** @param {number} pixel how large a pixel looks at a distance of one. */
  fit(pixel) {
    for (const sprite of this.children) sprite.scale.setScalar(DIAMETER * pixel);
  }

  /** Free what the graphics card holds. */
  dispose() {
    for (const sprite of this.children) {
      sprite.material.map.dispose();
      sprite.material.dispose();
    }
    this.clear();
  }
}

function dot(at, index) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = PIXELS;
  const context = canvas.getContext("2d");
  const middle = PIXELS / 2;
  context.beginPath();
  context.arc(middle, middle, middle - 4, 0, 2 * Math.PI);
  context.fillStyle = markColour(index);
  context.fill();
  context.lineWidth = 5;
  context.strokeStyle = "#ffffff";
  context.stroke();
  context.fillStyle = "#ffffff";
  context.font = `bold ${0.55 * PIXELS}px sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(String(index + 1), middle, middle + 2);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const material = new SpriteMaterial({
    map,
    depthTest: false,
    depthWrite: false,
    sizeAttenuation: false,
    toneMapped: false,
  });
  const sprite = new Sprite(material);
  sprite.position.set(...at);
  sprite.renderOrder = 10;
  sprite.userData.index = index;
  return sprite;
}
