// Writes each file of the build a second time, compressed, so that the service need not compress anything.
import { readdir, readFile, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { promisify } from "node:util";
import { brotliCompress, gzip } from "node:zlib";

const WORTH_IT = /\.(html|js|css|svg|json|map)$/;
const METHODS = { ".br": promisify(brotliCompress), ".gz": promisify(gzip) };

export function precompress() {
  let folder;
  return {
    name: "precompress",
    apply: "build",
    configResolved(config) {
      folder = join(config.root, config.build.outDir);
    },
    async closeBundle() {
      const names = await readdir(folder, { recursive: true });
      for (const name of names.filter((name) => WORTH_IT.test(name))) {
        const content = await readFile(join(folder, name));
        for (const [suffix, compress] of Object.entries(METHODS)) {
          await writeFile(join(folder, name + suffix), await compress(content));
        }
      }
    },
  };
}
