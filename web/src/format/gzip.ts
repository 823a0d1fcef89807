// The text of a group's table: one gzip member (RFC 1952).
import { MAX_TABLE_BYTES } from "../generated/constants.ts";
import { FormatError } from "./errors.ts";

/** The bytes in a gzip member; `where` names the file. Throws FormatError (not_json, too_large). */
export async function inflate(data: Uint8Array, where: string): Promise<Uint8Array> {
  const inflater = new DecompressionStream("gzip");
  const writer = inflater.writable.getWriter();
  // What is wrong with the data, the reader says too. The bytes are never those of a SharedArrayBuffer.
  writer.write(data as Uint8Array<ArrayBuffer>).catch(() => {});
  writer.close().catch(() => {});
  const text = await collect(inflater.readable.getReader(), where);
  // Node's inflater takes several members, and anything behind them.
  // The last four bytes are the length of the only one.
  const length = new DataView(data.buffer, data.byteOffset + data.length - 4).getUint32(0, true);
  if (length !== text.length) throw new FormatError("not_json", where, "expected JSON in one whole gzip member");
  return text;
}

async function collect(reader: ReadableStreamDefaultReader<Uint8Array>, where: string): Promise<Uint8Array> {
  const parts: Uint8Array[] = [];
  let length = 0;
  for (;;) {
    const { done, value } = await reader.read().catch((error: unknown) => {
      throw new FormatError("not_json", where, `expected JSON in gzip: ${error}`);
    });
    if (done) break;
    length += value.length;
    if (length > MAX_TABLE_BYTES) {
      reader.cancel().catch(() => {});
      throw new FormatError("too_large", where, `expected at most ${MAX_TABLE_BYTES} bytes of JSON`);
    }
    parts.push(value);
  }
  const text = new Uint8Array(length);
  let at = 0;
  for (const part of parts) {
    text.set(part, at);
    at += part.length;
  }
  return text;
}
