/** A canvas to draw on, with smooth edges where a graphics card draws them. */

const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;

let drawsOnProcessor;

/**
 * Make a canvas. Where no graphics card is there every pixel costs, so that the first context, which
 * finds that out, has no smooth edges and is kept.
 *
 * @returns {{canvas: HTMLCanvasElement, software: boolean}}
 */
export function freshCanvas() {
  const canvas = document.createElement("canvas");
  if (drawsOnProcessor === undefined) {
    const gl = canvas.getContext("webgl2", { antialias: false, stencil: true });
    const info = gl?.getExtension("WEBGL_debug_renderer_info");
    drawsOnProcessor = SOFTWARE.test(gl?.getParameter(info?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
    if (!drawsOnProcessor) {
      gl?.getExtension("WEBGL_lose_context")?.loseContext();
      return freshCanvas();
    }
  }
  return { canvas, software: drawsOnProcessor };
}
