// The player under conditions as people have them: links that fall and rise, servers that go, packages that grow, viewers
// who cannot decide. One check a visit; query: src, check, and what the check takes.
import { Player } from "../../src/airgs.ts";
import { canvas, type Log, number, query, sleep, src, start, until } from "../support/player-page.ts";

const unhandled: string[] = [];
addEventListener("unhandledrejection", ({ reason }) => unhandled.push(String(reason)));

/** Workers that run, and how many downloads were given up. */
const workers = new Set<Worker>();
let given = 0;
const fetches = new Set<number>();
const { postMessage, terminate } = Worker.prototype;
Worker.prototype.postMessage = function (this: Worker, ...args: unknown[]) {
  const message = args[0] as { id?: number; call?: string; cancel?: number };
  workers.add(this);
  if (message.call === "fetch" && message.id !== undefined) fetches.add(message.id);
  if (message.cancel !== undefined && fetches.has(message.cancel)) given++;
  Reflect.apply(postMessage, this, args);
};
Worker.prototype.terminate = function (this: Worker) {
  workers.delete(this);
  terminate.call(this);
};

/** Something that the test does when it is told to. */
const tell = (what: string) => fetch(`/${what}`).then((response) => response.text());

const report = (log: Log) => ({ ...log.report(), unhandled, given });

/** A player that shows the first picture. */
async function started(options = {}): Promise<Log> {
  const log = await start(options);
  await until("a picture", () => log.has("firstpicture"));
  return log;
}

const passes = async (log: Log, seconds: number) => {
  const from = log.player.currentTime;
  await until(`play after ${from} s`, () => log.player.currentTime >= from + seconds || log.player.ended);
};

const checks: Record<string, () => Promise<unknown>> = {
  /** Plays once, to the end. */
  async once() {
    const log = await start({ loop: false, bufferS: number("buffer", 4) });
    await until("the end", () => log.player.ended, 50);
    return report(log);
  },

  /** Plays once, to the end; when the best rung is shown the link falls, and rises again when another one is. */
  async link() {
    const log = await start({ loop: false, bufferS: 3 });
    const { player } = log;
    const isBest = () => {
      const best = Math.max(...player.rungs.map(({ psnr }) => psnr ?? 0));
      return player.rung !== null && player.rungs[player.rung].psnr === best;
    };
    await until("the best rung", isBest);
    await tell("end");
    await until("another rung", () => !isBest());
    const fell = log.rungs.at(-1);
    await tell("begin");
    await until("the best rung again", isBest);
    await until("the end", () => player.ended);
    return { ...report(log), fell };
  },

  /** After a second of play the server goes, for so many seconds; then the rest is played. */
  async away() {
    const log = await started({ loop: false, bufferS: 1.5 });
    await passes(log, 1);
    await tell("end");
    await sleep(1e3 * number("seconds", 3));
    await tell("begin");
    const beganS = performance.now() / 1e3;
    const before = log.player.currentTime;
    await until("play after it is back", () => log.player.currentTime > before + 0.4);
    const backS = performance.now() / 1e3 - beganS;
    await until("the end", () => log.player.ended);
    return { ...report(log), backS };
  },

  /** Joins a growing package, goes back, then to the newest moment, and on to the end. */
  async live() {
    const log = await started({ loop: false, bufferS: 4 });
    const { player } = log;
    const joined = { time: player.currentTime, duration: player.duration, live: player.live };
    await tell("begin");
    await until("growth", () => player.duration > joined.duration + 1);
    const times = [];
    player.pause();
    const back = number("back", 2);
    for (const seconds of [0, back, back, player.duration]) {
      await player.seek(seconds);
      await until(`${seconds} s`, () => !player.seeking);
      times.push(player.currentTime);
    }
    const grown = player.duration;
    player.play();
    await until("the end", () => player.ended);
    return { ...report(log), joined, times, grown, live: player.live };
  },

  /**
   * Speeds and the loop, changed on the way: seconds of the sequence a second at each speed, in some windows, as
   * the machine may be too slow in one of them.
   */
  async speeds() {
    const log = await started({ loop: false });
    const { player } = log;
    const rates = [];
    for (const speed of [2, 0.5]) {
      player.speed = speed;
      await sleep(500);
      const seen = [];
      for (let window = 0; window < 5; window++) {
        const [time, at] = [player.currentTime, performance.now()];
        await sleep(1000);
        seen.push((player.currentTime - time) / ((performance.now() - at) / 1e3));
      }
      rates.push({ speed, seen });
    }
    player.speed = 2;
    player.loop = true;
    await player.seek(player.duration - 1);
    await until("the sequence begins again", () => !player.seeking && player.currentTime < 3);
    player.loop = false;
    await player.seek(player.duration - 1);
    await until("the end", () => player.ended);
    const last = player.currentTime;
    player.loop = true;
    await until("play after the end", () => !player.ended && player.currentTime < 3);
    player.loop = false;
    await player.seek(player.duration - 1);
    await until("the end", () => player.ended);
    player.play();
    await until("play from the beginning", () => !player.ended && player.currentTime < 3);
    return { ...report(log), rates, last };
  },

  /** Seeks in a row, and others while downloads are under way. */
  async seeks() {
    const log = await started({ loop: false });
    const { player } = log;
    const landed = [];
    for (const wanted of [9, 2, 7, 4]) {
      player.seek(wanted);
      await until("one seek", () => !player.seeking);
      landed.push({ wanted, time: player.currentTime });
    }
    const wild = [9, 1, 7, 3, 11, 0, 5, 10, 2, 6];
    for (const seconds of wild) player.seek(seconds);
    player.pause();
    await until("the last one", () => !player.seeking);
    const last = player.currentTime;
    const times = [];
    for (const [seconds, wait] of [
      [10, 30],
      [3, 200],
      [8, 5],
      [0.5, 100],
    ]) {
      player.seek(seconds);
      await sleep(wait);
      player.quality = player.rungs[Math.floor(seconds) % 2].name; // neither of them undoes the other
    }
    await until("the last one", () => !player.seeking);
    times.push(player.currentTime);
    const still = player.currentTime;
    await sleep(600);
    const paused = player.currentTime === still;
    player.play();
    await passes(log, 1);
    return { ...report(log), landed, wanted: wild.at(-1), last, times, paused };
  },

  /** Pause and seek while playing waits for files. */
  async stall() {
    const log = await started({ loop: false, bufferS: 2 });
    const { player } = log;
    await tell("end");
    await until("a stall", () => log.has("stall"));
    player.pause();
    await sleep(500);
    const during = player.currentTime;
    player.seek(0);
    await sleep(300);
    player.seek(6);
    await sleep(300);
    await tell("begin");
    await until("what was sought", () => !player.seeking);
    const sought = player.currentTime;
    await sleep(500);
    const held = player.currentTime === sought;
    player.play();
    await passes(log, 1);
    return { ...report(log), during, sought, held };
  },

  /** Closes players at every moment, then opens one package while another one is opened; nothing of them is left. */
  async close() {
    const errors: string[] = [];
    for (const wait of [0, 5, 30, 100, 200, 400, 700, 1000]) {
      const player = new Player(canvas);
      player.on("problem", (event) => errors.push(JSON.stringify((event as CustomEvent).detail)));
      player.resize(64, 48);
      player.play();
      const opening = player.open(src).catch((error) => errors.push(String(error)));
      await sleep(wait);
      if (wait % 3) player.seek(1);
      player.close();
      await opening;
    }
    await sleep(300);
    const left = workers.size;
    const player = new Player(canvas);
    player.resize(64, 48);
    player.play();
    const opened: number[] = [];
    player.on("open", () => opened.push(player.fps));
    await Promise.all([player.open(src), player.open(query.get("other") ?? "")]);
    await player.open(src);
    await until("a picture", () => player.stats.framesShown > 0);
    const running = workers.size;
    player.close();
    return { errors, left, opened, running, workers: workers.size, unhandled };
  },
};

Object.assign(window, { report: checks[query.get("check") ?? "once"]() });
