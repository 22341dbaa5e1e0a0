/** A press of the pointer: what lies under it has to stay there until its click. */

let pressed = false;
const waiting = [];

addEventListener("pointerdown", () => (pressed = true), { capture: true });
for (const end of ["pointerup", "pointercancel", "blur"]) {
  addEventListener(end, () => setTimeout(release), { capture: true }); // the click comes in between
}

function release() {
  pressed = false;
  for (const go of waiting.splice(0)) go();
}

/** Wait until nothing is pressed, as before elements are replaced or moved. */
export function released() {
  return pressed ? new Promise((resolve) => waiting.push(resolve)) : Promise.resolve();
}
