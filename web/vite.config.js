// One script and one style sheet beside index.html, so that the page needs no server of its own kind.
import { defineConfig } from "vite";

export default defineConfig({
  build: {
    target: "es2022",
    outDir: "../datagen/view/site",
    emptyOutDir: true,
    lib: {
      entry: "src/app.ts",
      formats: ["iife"],
      name: "mixer",
      fileName: () => "app.js",
      cssFileName: "app",
    },
    rollupOptions: {
      output: { banner: "/*! The light mixer of DTC-MultiLight builder, GPL-3.0-or-later. Built by `make web` of web/. */" },
    },
  },
});
