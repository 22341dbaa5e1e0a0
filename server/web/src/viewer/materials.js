/** Looks as materials, and the room whose light falls on them. */
import { MeshPhysicalMaterial, PMREMGenerator } from "three";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";

import { LOOKS } from "./looks.js";

/** The material of a look; it does not let light through yet. */
export function material(name) {
  const { label, transmission = 0, thickness = 0, opacity = 1, ...rest } = LOOKS[name];
  const made = new MeshPhysicalMaterial(rest);
  made.userData = { transmission, thickness, opacity };
  return made;
}

/** Fit the way of light through it to the size of what is shown [grid units]. */
export function sized(made, size) {
  made.thickness = made.userData.thickness * size;
  made.attenuationDistance = size;
}

/** Let light through by refraction, or where that takes too long by mixing. */
export function refract(made, refracts) {
  const { transmission, opacity } = made.userData;
  const through = refracts ? transmission : 0;
  const seeThrough = !refracts && opacity < 1;
  if (made.transmission === through && made.transparent === seeThrough) return;
  made.transmission = through;
  made.transparent = seeThrough;
  made.opacity = seeThrough ? opacity : 1;
  made.needsUpdate = true;
}

/** The light of a room, as a texture for the scene's environment. */
export function roomLight(renderer) {
  const generator = new PMREMGenerator(renderer);
  const room = new RoomEnvironment();
  const { texture } = generator.fromScene(room, 0.04);
  room.dispose();
  generator.dispose();
  return texture;
}
