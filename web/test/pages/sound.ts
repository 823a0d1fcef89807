// The sound of a package that chirps (tests/support/chirps.py), as a page hears it, beside the pictures. Query: src, check.
import { query, sleep, start, until } from "../support/player-page.ts";

const SAMPLES = 2048;
/** Of the chirp: Hz, Hz a second. */
const [LOWEST, RISE] = [400, 400];
const QUIET = 0.02;

let ear: AnalyserNode | null = null;
const { connect } = AudioNode.prototype;
AudioNode.prototype.connect = function (this: AudioNode, ...to: unknown[]) {
  if (to[0] instanceof AudioDestinationNode) {
    ear = new AnalyserNode(this.context, { fftSize: SAMPLES });
    Reflect.apply(connect, this, [ear]);
  }
  return Reflect.apply(connect, this, to);
} as typeof connect;

/** How loud it is now, and the moment of the chirp that leaves the loudspeaker. */
function listen(): { loud: number; moment: number } {
  if (!ear) return { loud: 0, moment: Number.NaN };
  const samples = new Float32Array(SAMPLES);
  ear.getFloatTimeDomainData(samples);
  const loud = Math.sqrt(samples.reduce((sum, sample) => sum + sample * sample, 0) / SAMPLES);
  const crossings: number[] = [];
  for (let i = 1; i < SAMPLES; i++) {
    const [before, after] = [samples[i - 1], samples[i]];
    if (before < 0 !== after < 0) crossings.push(i - 1 + before / (before - after));
  }
  const [first, last] = [crossings[0], crossings.at(-1) ?? 0];
  const { sampleRate, baseLatency, outputLatency } = ear.context as AudioContext;
  const frequency = ((crossings.length - 1) / 2 / (last - first)) * sampleRate;
  const since = (SAMPLES - (first + last) / 2) / sampleRate;
  return { loud, moment: (frequency - LOWEST) / RISE + since - baseLatency - (outputLatency || 0) };
}

/** A touch, as far as the browser lets a page pretend one. */
const touch = () => document.body.click();

type Heard = { picture: number; sound: number; loud: number };

/** A player that sounds; what is heard is listed four times a second, when another frame is shown. */
async function sounding() {
  const log = await start({ loop: query.get("loop") !== "0" });
  const { player } = log;
  const heard: Heard[] = [];
  player.on("time", () => {
    const { loud, moment } = listen();
    if (loud > QUIET) heard.push({ picture: player.currentTime, sound: moment, loud });
  });
  await until("the sound", () => player.hasSound);
  touch();
  await until("the permission", () => !player.muted);
  return { log, player, heard };
}

const checks: Record<string, () => Promise<unknown>> = {
  /** Plays for some seconds, and then from a moment that is sought. */
  async beside() {
    const { log, player, heard } = await sounding();
    await until("pictures and sound", () => heard.length >= Number(query.get("looks") ?? 8), 90);
    const played = heard.splice(0);
    await player.seek(4);
    await until("pictures and sound after a seek", () => heard.length >= 4);
    const sought = heard.splice(0);
    player.pause();
    await sleep(300);
    const paused = listen().loud;
    player.muted = true;
    player.play();
    await until("more frames", () => player.currentTime > 5);
    const muted = listen().loud;
    return { ...log.report(), played, sought, paused, muted, isMuted: player.muted };
  },

  /** Plays past a file that comes late. */
  async stall() {
    const { log, player, heard } = await sounding();
    const first = () => log.events.indexOf("firstpicture");
    await until("the stall", () => first() >= 0 && log.events.includes("stall", first()));
    await sleep(300);
    const waiting = { loud: listen().loud, stalled: log.events.at(-1) === "stall", picture: player.currentTime };
    const before = heard.splice(0);
    await until("the end of it", () => player.currentTime > 3.2 && heard.length >= 4);
    return { ...log.report(), waiting, before, after: heard.splice(0) };
  },

  /** Plays what cannot be heard here. */
  async lacking() {
    Reflect.deleteProperty(globalThis, "AudioDecoder");
    const log = await start();
    await until("frames", () => log.player.stats.framesShown > 5 && log.problems.length > 0);
    return { ...log.report(), hasSound: log.player.hasSound };
  },
};

Object.assign(window, { report: checks[query.get("check") ?? "beside"]() });
