// The sound of a package: decoded by WebCodecs ahead of the pictures, and played by an AudioContext, whose clock leads the
// pictures while it is heard. It is heard at speed 1, while pictures are in time, once somebody has touched the page:
// browsers allow no sound before. `…S` are seconds of the page's clock, places those of the schedule (schedule.ts).
import { Recent } from "../format/collections.ts";
import { packetsOf, readSound } from "../format/sound.ts";
import { PACKET_TICKS, SOUND_RATE, WARM_UP } from "../generated/constants.ts";
import { UnsupportedError } from "../media/errors.ts";
import type { Playback } from "./playback.ts";
import type { Slot } from "./playout.ts";

/** So much of what follows is decoded and handed to the browser. */
const AHEAD_S = 2;
/** Pictures follow the sound by so much of the time that passes; where they are further apart, sound begins anew. */
const PULL = 0.05;
const APART_S = 0.04;
/** The clock of a context goes in steps: its least lag in such a time counts. */
const WINDOW_S = 0.3;
const MOST_GROUPS = 4;

interface Piece {
  /** null: it is on its way, or silent. */
  buffer: AudioBuffer | null;
  /** Its first sample follows the beginning of the segment by so many seconds. */
  fromS: number;
  node: AudioBufferSourceNode | null;
}

export class Sound {
  readonly #pieces = new Map<Slot, Piece>();
  readonly #files = new Recent<number, Promise<Uint8Array[]>>(MOST_GROUPS);
  readonly #end = new AbortController();
  #context: AudioContext | null = null;
  #gain: GainNode | null = null;
  /** The time of the context at which place 0 is played; null: nothing is. */
  #zeroS: number | null = null;
  #lags: { atS: number; lagS: number }[] = [];
  #beforeS = 0;

  private constructor(private readonly playback: Playback) {
    const { signal } = this.#end;
    // After the controls have heard it: to them, what is not heard yet is muted.
    for (const type of ["click", "keydown"]) document.addEventListener(type, () => this.follow(), { signal });
    const ends = playback.playout.onChange(() => this.#trim());
    signal.addEventListener("abort", ends);
    if (navigator.userActivation?.hasBeenActive) this.follow();
  }

  /** Throws UnsupportedError where the browser does not decode it. */
  static async of(playback: Playback): Promise<Sound> {
    const config = configOf(playback);
    const known = typeof AudioDecoder !== "undefined" && typeof AudioContext !== "undefined";
    if (!known || !(await AudioDecoder.isConfigSupported(config).catch(() => null))?.supported)
      throw new UnsupportedError("this browser does not decode the sound, Opus: only the pictures are played");
    return new Sound(playback);
  }

  /** Whether the browser lets it be heard. */
  get allowed(): boolean {
    return this.#context?.state === "running";
  }

  get leads(): boolean {
    return this.#zeroS !== null;
  }

  /** Take in whether it is wanted, and how loud; somebody may have touched the page. */
  follow(): void {
    const { muted, volume } = this.playback.wishes;
    if (!muted && !this.#context) this.#begin();
    if (!muted && !this.allowed) this.#context?.resume().catch(() => {}); // it is asked again at the next touch
    if (this.#gain) this.#gain.gain.value = muted ? 0 : volume;
  }

  /** Play what is due, and keep the pictures beside it; `calm`: these were in time lately. */
  step(nowS: number, calm: boolean): void {
    const { playout, wishes } = this.playback;
    this.#trim();
    if (!this.allowed || !this.#context) {
      this.#silence();
      return;
    }
    const at = playout.schedule.at(nowS);
    for (const slot of playout.slots) {
      if (slot.startAt < at + AHEAD_S && slot.startAt + slot.seconds > at && !this.#pieces.has(slot)) this.#load(slot);
    }
    if (playout.schedule.held || wishes.speed !== 1 || !calm) {
      this.#silence();
      return;
    }
    const { baseLatency, outputLatency, sampleRate } = this.#context;
    const heardS = this.#clock(nowS) - baseLatency - (outputLatency || 0);
    if (this.#zeroS !== null) {
      const off = heardS - this.#zeroS - at;
      const most = PULL * (nowS - this.#beforeS);
      if (Math.abs(off) > APART_S) this.#silence();
      else playout.schedule.shift(nowS, Math.max(-most, Math.min(most, off)));
    }
    this.#beforeS = nowS;
    this.#zeroS ??= Math.round((heardS - at) * sampleRate) / sampleRate;
    for (const [slot, piece] of this.#pieces) this.#play(slot, piece, this.#zeroS);
  }

  close(): void {
    this.#end.abort();
    this.#silence();
    this.#context?.close();
  }

  #begin(): void {
    this.#context = new AudioContext({ sampleRate: SOUND_RATE });
    this.#gain = this.#context.createGain();
    this.#gain.connect(this.#context.destination);
    this.#context.onstatechange = () => {
      this.#lags = [];
      this.playback.tell("volumechange");
    };
  }

  /** The time of the context, evenly. */
  #clock(nowS: number): number {
    this.#lags = this.#lags.filter(({ atS }) => atS > nowS - WINDOW_S);
    this.#lags.push({ atS: nowS, lagS: nowS - (this.#context?.currentTime ?? 0) });
    return nowS - Math.min(...this.#lags.map(({ lagS }) => lagS));
  }

  /** Drop what has passed, or is not due any more; all of it stops where the schedule stands still. */
  #trim(): void {
    const { playout } = this.playback;
    const at = playout.schedule.at(performance.now() / 1e3);
    const slots = new Set(playout.slots);
    for (const [slot, piece] of this.#pieces) {
      if (slots.has(slot) && slot.startAt + slot.seconds > at - AHEAD_S) continue;
      stop(piece);
      this.#pieces.delete(slot);
    }
    if (playout.schedule.held) this.#silence();
  }

  #silence(): void {
    this.#zeroS = null;
    for (const piece of this.#pieces.values()) stop(piece);
  }

  #play({ startAt }: Slot, piece: Piece, zeroS: number): void {
    if (!piece.buffer || piece.node || !this.#context || !this.#gain) return;
    const startS = zeroS + startAt + piece.fromS;
    const lateS = Math.max(0, this.#context.currentTime - startS);
    if (lateS >= piece.buffer.duration) return;
    piece.node = new AudioBufferSourceNode(this.#context, { buffer: piece.buffer });
    piece.node.connect(this.#gain);
    piece.node.start(startS + lateS, lateS);
  }

  /** Without its file, or where that is broken, a group is silent. */
  async #load(slot: Slot): Promise<void> {
    const piece: Piece = { buffer: null, fromS: 0, node: null };
    this.#pieces.set(slot, piece);
    const { media, offers } = this.playback;
    const { root } = media.tables;
    try {
      const group = media.tables.groupOf(offers.index(slot.position));
      const span = offers.span(slot.position);
      const { start, stop } = packetsOf(root, span);
      const first = packetsOf(root, media.tables.group(group)).start;
      const packets = await this.#files.of(group, () => this.#fetch(group));
      const before = start - first < WARM_UP ? ((await this.#files.get(group - 1)) ?? []) : [];
      const known = [...before, ...packets];
      const from = before.length + start - first;
      const warm = Math.min(from, WARM_UP);
      const wanted = known.slice(from - warm, from + stop - start);
      piece.fromS = (start * PACKET_TICKS - (root.sound?.pre_skip ?? 0)) / SOUND_RATE - span.start / offers.fps;
      if (wanted.length > warm) piece.buffer = await decode(configOf(this.playback), wanted, warm);
    } catch {
      piece.buffer = null;
    }
  }

  async #fetch(group: number): Promise<Uint8Array[]> {
    const { tables } = this.playback.media;
    const [path] = tables.soundFiles(group);
    if (!path) return [];
    return readSound(
      await this.playback.media.sound(group, this.#end.signal),
      path,
      packetsOf(tables.root, tables.group(group)),
    );
  }
}

function stop(piece: Piece): void {
  piece.node?.stop();
  piece.node = null;
}

const configOf = ({ media }: Playback): AudioDecoderConfig => ({
  codec: "opus",
  sampleRate: SOUND_RATE,
  numberOfChannels: media.tables.root.sound?.channels ?? 1,
});

/** Samples of packets but for the first `warm`, after which a decoder is right. Rejects with what the decoder says. */
async function decode(config: AudioDecoderConfig, packets: Uint8Array[], warm: number): Promise<AudioBuffer> {
  const parts: Float32Array<ArrayBuffer>[][] = [];
  const duration = (1e6 * PACKET_TICKS) / SOUND_RATE;
  await new Promise<void>((resolve, reject) => {
    const decoder = new AudioDecoder({ output: (data) => parts.push(planesOf(data)), error: reject });
    decoder.configure(config);
    packets.forEach((data, k) => {
      decoder.decode(
        new EncodedAudioChunk({ type: "key", timestamp: duration * k, duration, data: data as BufferSource }),
      );
    });
    const close = () => decoder.state !== "closed" && decoder.close();
    decoder.flush().then(resolve, reject).finally(close);
  });
  const length = PACKET_TICKS * (packets.length - warm);
  const numberOfChannels = parts[0]?.length ?? 1; // a browser may make two of one
  const buffer = new AudioBuffer({ length, numberOfChannels, sampleRate: SOUND_RATE });
  let at = -PACKET_TICKS * warm;
  for (const planes of parts) {
    for (const [channel, plane] of planes.entries()) {
      if (at + plane.length > 0) buffer.copyToChannel(plane.subarray(Math.max(0, -at)), channel, Math.max(0, at));
    }
    at += planes[0].length;
  }
  return buffer;
}

function planesOf(data: AudioData): Float32Array<ArrayBuffer>[] {
  const planes = Array.from({ length: data.numberOfChannels }, (_, planeIndex) => {
    const plane = new Float32Array(data.numberOfFrames);
    data.copyTo(plane, { planeIndex, format: "f32-planar" });
    return plane;
  });
  data.close();
  return planes;
}
