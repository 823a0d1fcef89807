// The sound of a package that chirps (tests/support/chirps.py), as a page hears it, beside the pictures. Query: src, check.
import type { Player } from "../../src/airgs.ts";
import { number, query, sleep, start, until } from "../support/player-page.ts";

const SAMPLES = 2048;
/** Of the chirp: Hz, Hz a second. */
const [LOWEST, RISE] = [400, 400];
const QUIET = 0.02;
/** Halves of what is heard that are further apart are of two chirps. */
const SINGLE_S = 0.2;

let ear: AnalyserNode | null = null;
const { connect } = AudioNode.prototype;
AudioNode.prototype.connect = function (this: AudioNode, ...to: unknown[]) {
  if (to[0] instanceof AudioDestinationNode) {
    ear = new AnalyserNode(this.context, { fftSize: SAMPLES });
    Reflect.apply(connect, this, [ear]);
  }
  return Reflect.apply(connect, this, to);
} as typeof connect;

/** What leaves the loudspeaker now: how loud it is, and the moment of the chirp; null: it is no single tone, as where one
 * chirp ends and another begins.
 */
function listen(): { loud: number; moment: number | null } {
  if (!ear) return { loud: 0, moment: null };
  const samples = new Float32Array(SAMPLES);
  ear.getFloatTimeDomainData(samples);
  const loud = Math.sqrt(samples.reduce((sum, sample) => sum + sample * sample, 0) / SAMPLES);
  const [early, late] = [pitch(samples, 0, SAMPLES / 2), pitch(samples, SAMPLES / 2, SAMPLES)];
  const { sampleRate, baseLatency, outputLatency } = ear.context as AudioContext;
  const scale = sampleRate / RISE;
  const same = Math.abs(late.frequency - early.frequency) * scale < SINGLE_S;
  const whole = pitch(samples, 0, SAMPLES);
  const since = (SAMPLES - whole.middle) / sampleRate;
  const moment = whole.frequency * scale - LOWEST / RISE + since - baseLatency - (outputLatency || 0);
  return { loud, moment: same ? moment : null };
}

/** Periods a sample of a part of the samples, and where its middle is. */
function pitch(samples: Float32Array, from: number, to: number): { frequency: number; middle: number } {
  const crossings: number[] = [];
  for (let i = from + 1; i < to; i++) {
    const [before, after] = [samples[i - 1], samples[i]];
    if (before < 0 !== after < 0) crossings.push(i - 1 + before / (before - after));
  }
  const [first, last] = [crossings[0], crossings.at(-1) ?? 0];
  return { frequency: (crossings.length - 1) / 2 / (last - first), middle: (first + last) / 2 };
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
    if (loud > QUIET && moment !== null) heard.push({ picture: player.currentTime, sound: moment, loud });
  });
  await until("the sound", () => player.hasSound);
  touch();
  await until("the permission", () => !player.muted);
  return { log, player, heard };
}

/** What is heard with new pictures in the last second of the loop, and in the first: so many of each. */
async function seamOf(player: Player, count: number): Promise<{ ends: Heard[]; begins: Heard[] }> {
  const [ends, begins]: Heard[][] = [[], []];
  let picture = Number.NaN;
  let goesOn = true;
  const look = () => {
    if (goesOn) requestAnimationFrame(look);
    const { loud, moment } = listen();
    if (player.currentTime === picture) return;
    picture = player.currentTime;
    if (loud <= QUIET || moment === null) return;
    if (picture > player.duration - 1) ends.push({ picture, sound: moment, loud });
    if (picture < 1) begins.push({ picture, sound: moment, loud });
  };
  look();
  await until("pictures and sound", () => Math.min(ends.length, begins.length) >= count, 90);
  goesOn = false;
  return { ends, begins };
}

const checks: Record<string, () => Promise<unknown>> = {
  /**
   * Plays for some seconds, then from a moment that is sought, and from the end of the loop into the next one; with
   * `looks` until so many have heard something, in the first second and after the second one.
   */
  async beside() {
    const { log, player, heard } = await sounding();
    if (query.has("looks")) {
      const looks = () => heard.length >= number("looks", 0) && heard.some((one) => one.picture < 1);
      await until("sound before and after a second", () => looks() && heard.some((one) => one.picture > 2), 90);
      return { ...log.report(), played: heard };
    }
    const early = () => heard.filter(({ picture }) => picture < 3);
    await until("pictures and sound", () => early().length >= 8, 90);
    const played = early();
    heard.splice(0);
    await player.seek(4);
    await until("pictures and sound after a seek", () => heard.length >= 4);
    const sought = heard.splice(0);
    await player.seek(player.duration - 1);
    const seam = await seamOf(player, 10);
    player.pause();
    await sleep(300);
    const paused = listen().loud;
    player.muted = true;
    player.play();
    await sleep(500);
    const muted = listen().loud;
    return { ...log.report(), played, sought, seam, paused, muted, isMuted: player.muted };
  },

  /** Plays past a file that the server withholds until it is told, when there is a stall. */
  async stall() {
    const { log, player, heard } = await sounding();
    const first = () => log.events.indexOf("firstpicture");
    await until("the stall", () => first() >= 0 && log.events.includes("stall", first()));
    await sleep(300);
    const waiting = { loud: listen().loud, stalled: log.events.at(-1) === "stall", picture: player.currentTime };
    const before = heard.splice(0);
    await fetch("/go");
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
