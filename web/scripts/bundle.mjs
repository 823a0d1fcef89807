// How TypeScript becomes what browsers and Node run: esbuild, with workers inside the script that starts them, so that
// one file is all that a page needs, from whatever origin it comes.
//
// `import { start } from "worker:./NAME.ts"` gives a function that starts a worker, in which `run` of NAME.ts is called.
import { readFile, writeFile } from "node:fs/promises";
import { build, transform } from "esbuild";
import { minify } from "terser";

const COMMON = { bundle: true, target: "es2022", charset: "utf8", legalComments: "none", logLevel: "warning" };

/** Finds "worker:…"; `load` makes the module that has `start` from the path of the worker's source. */
const workers = (load) => ({
  name: "workers",
  setup(plugins) {
    plugins.onResolve({ filter: /^worker:/ }, async ({ path, resolveDir }) => {
      const found = await plugins.resolve(path.slice("worker:".length), { resolveDir, kind: "import-statement" });
      return found.errors.length ? { errors: found.errors } : { path: found.path, namespace: "worker" };
    });
    plugins.onLoad({ filter: /.*/, namespace: "worker" }, ({ path }) => load(path));
  },
});

/** A style sheet is imported as its text, which is for the shadow of an element. */
const styles = {
  name: "styles",
  setup(plugins) {
    plugins.onLoad({ filter: /\.css$/ }, async ({ path }) => {
      const { code } = await transform(await readFile(path, "utf8"), { loader: "css", minify: true, target: "es2022" });
      return { contents: code.trim(), loader: "text" };
    });
  },
};

/** Modules that are mostly GLSL lose its comments, and spaces that nobody needs: of minus signs two would be one. */
const shaders = {
  name: "shaders",
  setup(plugins) {
    plugins.onLoad({ filter: /render[/].*shaders?[.]ts$/ }, async ({ path }) => {
      const text = (await readFile(path, "utf8")).replace(/\s*[/][/].*$/gm, "").replace(/^\s+/gm, "");
      return { contents: text.replace(/ *([=*,;(){}<>?:&|+/]) */g, "$1").replace(/([;,{}(])\n/g, "$1"), loader: "ts" };
    });
  },
};

/** What is imported as it is needed is a script beside the one that imports it, airgs-NAME.js. */
const parts = {
  name: "parts",
  setup(plugins) {
    plugins.onResolve({ filter: /^[.].*[.]ts$/ }, ({ path, kind }) => {
      if (kind !== "dynamic-import") return null;
      return { path: path.replace(/.*[/](airgs-)?(.*)[.]ts$/, "./airgs-$2.js"), external: true };
    });
  },
};

/** Without these what esbuild adds for import(…), though nothing calls it, goes away. */
const NO_REQUIRE = { require: undefined, Proxy: undefined };

const STARTED = `
const url=URL.createObjectURL(new Blob([code],{type:"text/javascript"}));
const worker=new Worker(url,{type:"module"});
URL.revokeObjectURL(url);
return worker;`;

/**
 * Bundles `entries` (name -> source file) into `folder` as NAME.js; each worker is a script of its own in them. With
 * `splitting`, what some have in common, and what is imported as it is needed, are files of their own.
 */
export async function bundle(entries, folder, { splitting = false, ...options } = {}) {
  const load = async (path) => {
    const contents = `import { run } from ${JSON.stringify(path)};\nrun();`;
    const stdin = { contents, resolveDir: "/", loader: "ts" };
    const made = await build({ ...COMMON, ...options, format: "esm", stdin, write: false });
    return {
      contents: `const code = ${JSON.stringify(made.outputFiles[0].text)};\nexport function start() {${STARTED}\n}`,
    };
  };
  await build({
    ...COMMON,
    ...options,
    format: "esm",
    entryPoints: entries,
    outdir: folder,
    splitting,
    plugins: [workers(load), styles, ...(splitting ? [shaders] : [parts])],
  });
}

/**
 * Bundles a module that does nothing with its page when it is imported into `file`, minified: what terser makes of
 * esbuild's code is smaller by 3 % as gzip. Its workers run the same code, a function that is given its own text, so
 * that nothing is there twice.
 */
export async function bundleOnce(entry, file) {
  const load = (path) => {
    const name = JSON.stringify(path.split("/").pop());
    const run = `import { run } from ${JSON.stringify(path)};\nif (role === ${name}) run();`;
    return { contents: `${run}\nexport const start = () => startWorker(${name});`, resolveDir: "/" };
  };
  const options = { ...COMMON, minify: true, format: "iife", globalName: "module", metafile: true, write: false };
  const made = await build({ ...options, entryPoints: [entry], plugins: [workers(load), styles, shaders, parts] });
  const { code } = await minify(made.outputFiles[0].text, {
    compress: { passes: 4, keep_fargs: false, unsafe: true, unsafe_arrows: true, global_defs: NO_REQUIRE },
    ecma: 2022,
  });
  const names = await exportsOf(entry);
  await writeFile(
    file,
    `const library = (library, role) => {
const startWorker = (name) => {
const code = "const library = " + library + ";library(library," + JSON.stringify(name) + ")";${STARTED}
};
${code}return module;
};
export const { ${names.join(", ")} } = library(library);
`,
  );
}

/** Names that a module exports, types aside. */
async function exportsOf(entry) {
  const empty = workers(() => ({ contents: "export const start = null;" }));
  const options = {
    ...COMMON,
    format: "esm",
    metafile: true,
    write: false,
    entryPoints: [entry],
    plugins: [empty, styles, parts],
  };
  const { metafile } = await build(options);
  return Object.values(metafile.outputs)[0].exports;
}
