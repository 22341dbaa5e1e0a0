/** Files that belong together, such as an OBJ with its materials and pictures, as one file to send. */

import { zipSync } from "fflate";

/** Where one of these is, the others belong to it; the first kind that there is counts. */
const MESHES = [["gltf"], ["glb", "obj", "ply", "stl", "off", "zip"]];

/**
 * The file to send: the only one, or a ZIP of all, named after the mesh among them; none of none.
 *
 * @param {Array<{path: string, file: File}>} found
 * @returns {Promise<File | undefined>}
 */
export async function packed(found) {
  if (found.length < 2) return found[0]?.file;
  const kind = ({ path }) => path.split(".").at(-1).toLowerCase();
  const mesh = MESHES.flatMap((kinds) => found.filter((one) => kinds.includes(kind(one))))[0] ?? found[0];
  const contents = await Promise.all(found.map(({ file }) => file.arrayBuffer()));
  const paths = Object.fromEntries(found.map(({ path }, i) => [path, new Uint8Array(contents[i])]));
  const name = mesh.file.name.replace(/\.[^.]*$/, "");
  return new File([zipSync(paths, { level: 0 })], `${name}.zip`);
}

/**
 * Files that were dropped, and those in folders that were dropped.
 *
 * @param {DataTransfer} transfer of the event, which has it only while it is handled
 * @returns {Array<{path: string, file: File}> | Promise} the latter where there are folders
 */
export function droppedFiles(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.());
  if (!entries.some((entry) => entry?.isDirectory)) return pickedFiles(transfer.files);
  return Promise.all(entries.filter(Boolean).map(filesOf)).then((lists) => lists.flat());
}

/** Files that were picked, likewise. */
export function pickedFiles(files) {
  return [...files].map((file) => ({ path: file.name, file }));
}

async function filesOf(entry) {
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
    return [{ path: entry.fullPath.slice(1), file }];
  }
  const reader = entry.createReader();
  const inside = [];
  for (;;) {
    // a reader gives up to 100 entries at a time
    const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (!some.length) break;
    inside.push(...some);
  }
  return (await Promise.all(inside.map(filesOf))).flat();
}
