// The engine on the page's own thread, where its decoders can be watched and harmed.
import { groupPath } from "../../src/format/paths.ts";
import { Engine } from "../../src/media/engine.ts";
import type { WireError } from "../../src/media/errors.ts";

interface Harm {
  /** Pictures after which decoders break down, and how often. */
  after: number;
  times: number;
}

const Real = globalThis.VideoDecoder;
const seen: VideoFrame[] = [];
let made = 0;

/** Remembers every picture, and breaks down where it should. */
class Watched extends Real {
  constructor(init: VideoDecoderInit, harm: Harm) {
    let count = 0;
    super({
      error: init.error,
      output: (frame) => {
        seen.push(frame);
        if (harm.times > 0 && count++ === harm.after) {
          harm.times--;
          frame.close();
          this.close();
          init.error(new DOMException("Codec reclaimed due to inactivity.", "QuotaExceededError"));
        } else init.output(frame);
      },
    });
    made++;
  }
}

function watch(harm: Harm): void {
  seen.length = 0;
  made = 0;
  globalThis.VideoDecoder = class extends Watched {
    constructor(init: VideoDecoderInit) {
      super(init, harm);
    }
  };
}

/** A closed picture has no format any more. */
const unclosed = () => seen.filter((frame) => frame.format !== null).length;

/** Decodes the first segment of a package; says what came, how many decoders it took, and which pictures are not closed. */
async function watched(step: Record<string, unknown>): Promise<unknown> {
  const {
    url,
    after = 0,
    times = 0,
    abortAt = -1,
    level = 0,
  } = step as { url: string; after?: number; times?: number; abortAt?: number; level?: number };
  const stop = new AbortController();
  const { signal } = stop;
  const { engine } = await Engine.open(
    { url: new URL(`${url}/`, location.href).href, aheadBytes: 1e9, keptBytes: 1e9, attempts: 1 },
    { emit: () => {}, signal },
  );
  const context = { id: 1, signal, emit: () => {} };
  const { tables } = engine;
  const fetched = async (paths: string[]) => {
    const { refused } = await engine.fetch({ paths, attempts: 1 }, context);
    if (refused.length) throw new Error(JSON.stringify(refused as [string, WireError][]));
  };
  await fetched([groupPath(1)]);
  const { tiers } = tables.root;
  watch({ after, times }); // before keyframes come: they are decoded then
  await fetched(Array.from({ length: tiers }, (_, tier) => tables.keyframeFiles(0, tier, 0)).flat());
  await fetched(tables.deltaFiles(0, level));
  const came: number[] = [];
  let said = "";
  try {
    await engine.canonical({ group: 0, quality: 0, tiers }, context);
    const emit = ({ t }: { t: number }) => {
      came.push(t);
      if (t === abortAt) stop.abort();
    };
    await engine.segment({ index: 0, level, of: { group: 0, quality: 0, tiers } }, { id: 2, signal, emit });
  } catch (error) {
    said = (error as Error).message;
  } finally {
    globalThis.VideoDecoder = Real;
  }
  return { came, said, made, pictures: seen.length, unclosed: unclosed() };
}

export const decodes = { watched };
