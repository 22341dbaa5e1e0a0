/** Ambient occlusion: creases of the surface are darker. Three's own pass, multiplied onto the finished picture. */
import { Vector2 } from "three";
import { GTAOPass } from "three/addons/postprocessing/GTAOPass.js";
import { FullScreenQuad } from "three/addons/postprocessing/Pass.js";

const REACH = 0.16; // how far a crease darkens, in radii of what is shown
const INTENSITY = 0.85;

export class Occlusion {
  constructor(scene, camera) {
    this.pass = new GTAOPass(scene, camera);
    this.pass.output = GTAOPass.OUTPUT.Off;
    this.quad = new FullScreenQuad(this.pass.blendMaterial);
    this.size = new Vector2();
  }

  /** Darken what the renderer has drawn of a scene that is so large [grid units]. */
  render(renderer, radius) {
    const { x, y } = this.size;
    renderer.getDrawingBufferSize(this.size);
    if (x !== this.size.x || y !== this.size.y) this.pass.setSize(this.size.x, this.size.y);
    this.pass.updateGtaoMaterial({ radius: REACH * radius, thickness: REACH * radius, distanceFallOff: 1, scale: 1.2 });
    this.pass.render(renderer);
    this.pass.blendMaterial.uniforms.intensity.value = INTENSITY;
    this.pass.blendMaterial.uniforms.tDiffuse.value = this.pass.gtaoMap;
    renderer.setRenderTarget(null);
    renderer.autoClear = false;
    this.quad.render(renderer);
    renderer.autoClear = true;
  }

  dispose() {
    this.pass.dispose();
    this.quad.dispose();
  }
}
