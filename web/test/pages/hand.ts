// The page that is shipped, as a hand finds it: its poster, where the subject is, and what a drag and a double click do.
// Query of the page: `shots`, a folder that pictures are written to.
import type { Player } from "../../src/airgs.ts";
import type { AirgsPlayer } from "../../src/airgs-player.ts";

declare global {
  interface Window {
    drive(method: string, ...values: unknown[]): Promise<unknown>;
    report: Promise<object>;
  }
}

const SIZES = { wide: { width: 480, height: 270 }, tall: { width: 300, height: 500 } };
const DRAGS = 5;
const BRIGHT = 40; // of 255: the subject, before black
const LEFT_OUT = 0.01; // of its pixels, at both sides

const wait = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));
const frame = () => new Promise((resolve) => requestAnimationFrame(resolve));
const node = () => document.querySelector("airgs-player") as AirgsPlayer;
const player = () => node().player as unknown as Player;
const find = (selector: string) => node()?.shadowRoot?.querySelector<HTMLElement>(selector) ?? null;
const seen = (selector: string) => find(selector)?.checkVisibility() ?? false;

async function until(what: string, condition: () => boolean, seconds = 60): Promise<void> {
  const end = performance.now() + 1e3 * seconds;
  while (!condition()) {
    if (performance.now() > end) throw new Error(`${what}: not within ${seconds} s`);
    await wait(20);
  }
}

/** Until neither camera nor canvas have changed for some pictures, and all pixels are drawn. */
async function rest(): Promise<void> {
  const state = () => JSON.stringify([player().camera, player().canvas.width]);
  for (let still = 0, before = ""; still < 15; before = state()) {
    await frame();
    still = before === state() ? still + 1 : 0;
  }
}

async function resize(size: { width: number; height: number }): Promise<void> {
  await window.drive("setViewportSize", size);
  await until("the size", () => player().canvas.width === size.width);
  await rest();
}

/** Where the subject is: the middle of its sides and its width, shares of the picture's width. */
async function subject(): Promise<{ middle: number; width: number }> {
  player().camera = { ...player().camera }; // something to draw
  const { width, height } = player().canvas;
  const pen = new OffscreenCanvas(width, height).getContext("2d")!;
  const columns = new Float64Array(width);
  for (let sum = 0; sum === 0; sum = columns.reduce((all, one) => all + one)) {
    await frame();
    pen.drawImage(player().canvas, 0, 0);
    const { data } = pen.getImageData(0, 0, width, height);
    for (let i = 0; i < data.length; i += 4)
      if (Math.max(...data.subarray(i, i + 3)) > BRIGHT) columns[(i / 4) % width]++;
  }
  const total = columns.reduce((all, one) => all + one);
  const at = (share: number) => {
    let [x, sum] = [0, 0];
    while (sum < share * total) sum += columns[x++];
    return x / width;
  };
  const [left, right] = [at(LEFT_OUT), at(1 - LEFT_OUT)];
  return { middle: (left + right) / 2, width: right - left };
}

/** The poster and the first picture, as they are seen without anything on top of them. */
async function pictures(name: string, shots: string): Promise<void> {
  const poster = find(".poster")!;
  for (const other of [".bar", ".big", ".notes", ".edge", ".spinner"]) find(other)!.style.display = "none";
  poster.style.transition = "none";
  for (const [what, opacity] of [
    ["poster", "1"],
    ["first", "0"],
  ]) {
    poster.style.opacity = opacity;
    await frame();
    await window.drive("screenshot", { path: `${shots}/${name}-${what}.png` });
  }
}

async function run(): Promise<object> {
  const shots = new URLSearchParams(location.search).get("shots") ?? "";
  await window.drive("setViewportSize", SIZES.wide);
  await until("a picture", () => !!node() && player()?.stats.framesShown > 0 && !!find(".panel"));
  const still = {
    play: seen("[data-icon=play], [data-icon=pause]"),
    line: seen(".timeline"),
    time: find(".time")?.textContent,
  };
  if (!shots) {
    await until("all pixels", () => player().canvas.width === SIZES.wide.width, 5);
    await wait(1000);
    const { width } = player().canvas;
    find("[aria-label^=Quality]")!.click();
    await until("the menu", () => seen(".menu"));
    return { ...still, width, paused: player().paused, big: seen(".big"), menu: find(".menu")!.innerText };
  }
  player().quality = player().rungs[0].name;
  player().pause();
  await player().seek(0);
  await until("the best rung", () => player().rung === 0 && !player().seeking);
  await resize(SIZES.tall);
  const tall = await subject();
  await pictures("tall", shots);
  await resize(SIZES.wide);
  await pictures("wide", shots);
  const turned = [await subject()];
  await window.drive("mouse.move", 40, 135);
  await window.drive("mouse.down");
  for (let i = 1; i <= DRAGS; i++) {
    await window.drive("mouse.move", 40 + (400 * i) / DRAGS, 135);
    await rest();
    turned.push(await subject());
  }
  await window.drive("mouse.up");
  node().viewRegion = "free";
  await window.drive("keyboard.press", "r");
  await rest();
  const before = player().camera;
  await window.drive("mouse.dblclick", 290, 110);
  await until("a look", () => player().camera.forward[1] !== before.forward[1]);
  await rest();
  const looked = player().camera;
  await window.drive("mouse.move", 240, 135);
  await window.drive("mouse.down");
  await window.drive("mouse.move", 340, 135, { steps: 4 });
  await wait(150); // no fling
  await window.drive("mouse.up");
  await rest();
  const around = player().camera;
  await window.drive("keyboard.press", "f");
  await until("a way", () => player().camera.position[0] !== around.position[0]);
  await rest();
  return { ...still, tall, turned, before, looked, around, framed: await subject() };
}

window.report = run();
