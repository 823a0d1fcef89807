// Sound: FORMAT.md, section 2. Packet k of Opus, from 0, starts at k / PACKETS seconds; frames are [start, stop).
import { PACKET_TICKS, PACKETS } from "../generated/constants.ts";
import { FormatError } from "./errors.ts";
import { readPackets } from "./mp4.ts";
import type { Root } from "./types.ts";

interface Span {
  start: number;
  stop: number;
}

export function packetsOf({ frame_rate }: Pick<Root, "frame_rate">, { start, stop }: Span): Span {
  const [frames, seconds] = frame_rate.map(BigInt) as [bigint, bigint];
  const first = (frame: number) => Number((BigInt(frame) * BigInt(PACKETS) * seconds + frames - 1n) / frames);
  return { start: first(start), stop: first(stop) };
}

/** The packets of a file that is to have these. Throws FormatError(bad_sound). */
export function readSound(data: Uint8Array, where: string, { start, stop }: Span): Uint8Array[] {
  const samples = readPackets(data, where);
  const first = samples[0]?.time;
  if (first !== start * PACKET_TICKS || samples.length !== stop - start) {
    const expected = `${stop - start} packets from ${start * PACKET_TICKS}`;
    throw new FormatError("bad_sound", where, `expected ${expected}, got ${samples.length} from ${first}`);
  }
  return samples.map((sample) => sample.data);
}
