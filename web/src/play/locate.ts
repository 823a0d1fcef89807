// Where a frame is, in a package whose tables are read as they are needed.
import { MissingPageError } from "../format/index.ts";
import { MissingGroupError } from "../format/package.ts";
import { groupPath } from "../format/paths.ts";
import type { Media } from "../media/client.ts";

/** The segment that shows a frame; fetches the pages and tables of its group, and of its base. Throws FormatError, TransportError. */
export async function locate(media: Media, frame: number, signal: AbortSignal): Promise<number> {
  for (;;) {
    const path = missing(media, frame);
    if (path === null) return media.tables.segmentAt(frame);
    const { refused } = await media.fetch([path], { signal });
    signal.throwIfAborted();
    const refusal = refused.get(path);
    if (refusal) throw refusal;
  }
}

function missing({ tables }: Media, frame: number): string | null {
  try {
    tables.baseTable(tables.index.atFrame(frame));
    return null;
  } catch (error) {
    if (error instanceof MissingPageError) return error.path;
    if (error instanceof MissingGroupError) return groupPath(error.group + 1);
    throw error;
  }
}
