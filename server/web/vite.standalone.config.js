import { defineConfig } from "vite";

// One script and one style sheet, which Python puts into files that are opened without a service.
export default defineConfig({
  build: {
    target: "es2022",
    outDir: "../../morph_engine/export/viewer",
    emptyOutDir: true,
    license: { fileName: "licenses.txt" }, // which go along with the script
    lib: { entry: "src/standalone/standalone.js", name: "morph", formats: ["iife"], fileName: () => "viewer.js", cssFileName: "viewer" },
  },
});
