// What browsers lack, each taken away from this one before a page's own scripts run.

/** Runs a script first in all workers, which come as blobs. */
function inWorkers(script: string): void {
  globalThis.Blob = class extends Blob {
    constructor(parts: BlobPart[] = [], options: BlobPropertyBag = {}) {
      super(/javascript/.test(options.type ?? "") ? [script, ...parts] : parts, options);
    }
  };
}

const without = (name: string) => Reflect.deleteProperty(globalThis, name);

export const lacks: Readonly<Record<string, () => void>> = {
  HTTPS: () => Object.defineProperty(globalThis, "isSecureContext", { value: false }),
  WebCodecs: () => without("VideoDecoder"),
  "WebCodecs in workers": () => inWorkers("delete globalThis.VideoDecoder;"),
  "H.264": () => inWorkers("VideoDecoder.isConfigSupported = async () => ({ supported: false });"),
  "a decoder that works": () =>
    inWorkers("VideoDecoder.prototype.decode = function () { throw new Error('broken'); };"),
  "WebGL 2": () => without("WebGL2RenderingContext"),
  "a WebGL 2 context": () => {
    const { getContext } = HTMLCanvasElement.prototype;
    HTMLCanvasElement.prototype.getContext = function (this: HTMLCanvasElement, ...asked: unknown[]) {
      return asked[0] === "webgl2" ? null : Reflect.apply(getContext, this, asked);
    } as typeof getContext;
  },
  workers: () => without("Worker"),
  "more than one worker": () => {
    let count = 0;
    globalThis.Worker = class extends Worker {
      constructor(url: string | URL, options?: WorkerOptions) {
        super(++count > 1 ? "data:text/javascript,throw 1" : url, options);
      }
    };
  },
  "workers that start": () => inWorkers("throw new Error('no such thing');"),
  patience: () => inWorkers("const wait = setTimeout; globalThis.setTimeout = (run, ms) => wait(run, ms / 20);"),
};
