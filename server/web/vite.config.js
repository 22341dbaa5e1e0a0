import { defineConfig } from "vite";

import { precompress } from "./precompress.js";

// `npm run dev` shows the page with a service of this machine behind it.
const service = process.env.MORPH_URL ?? "http://127.0.0.1:8000";

export default defineConfig({
  plugins: [precompress()],
  build: {
    target: "es2022",
    // An inlined script or style would break the Content-Security-Policy.
    assetsInlineLimit: 0,
    license: { fileName: "licenses.txt" }, // of the libraries that are built in
    manifest: true, // tells the service what to announce with the document
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1000,
  },
  server: { proxy: { "/v1": service, "/docs": service, "/readyz": service } },
});
