// An example of examples/ in a frame of its own, as a visitor sees it.
//
//     ?page=URL&size=PIXELS&wanted=NUMBER|WORDS      its URL; side of its window; how many frames of the package to wait
//                                                    for, or the words of the one after which there is none
//
// Reports the words that it showed, and its last picture as RGBA from the top.
const QUIET = 10; // pictures between two that must be alike: depth orders come later than Gaussians
const query = new URLSearchParams(location.search);
const size = Number(query.get("size"));

const frame = document.createElement("iframe");
frame.style.cssText = `border: 0; width: ${size}px; height: ${size}px`;
frame.src = query.get("page")!;

/**
 * After the next picture of the example, as long as it can be read: what is asked for between two pictures comes after
 * what the example has asked for in the last one.
 */
async function nextPicture(): Promise<void> {
  await new Promise((resolve) => setTimeout(resolve));
  await new Promise((resolve) => frame.contentWindow!.requestAnimationFrame(resolve));
}

function picture(): Uint8ClampedArray {
  const copy = document.createElement("canvas");
  copy.width = size;
  copy.height = size;
  const context = copy.getContext("2d")!;
  context.drawImage(frame.contentDocument!.querySelector("canvas")!, 0, 0);
  return context.getImageData(0, 0, size, size).data;
}

async function said(): Promise<string[]> {
  const wanted = query.get("wanted")!;
  const words = new Set<string>();
  while (words.size < Number(wanted) || (Number.isNaN(Number(wanted)) && !words.has(wanted))) {
    await nextPicture();
    const now = frame.contentDocument!.querySelector("output")!.textContent;
    if (now) words.add(now);
    if (now && !now.startsWith("frame ")) break; // an error
  }
  return [...words];
}

/** The next picture that is not black: the first depth order comes later than the words. */
async function drawn(): Promise<Uint8ClampedArray> {
  for (;;) {
    await nextPicture();
    const now = picture();
    if (now.some((value, i) => i % 4 < 3 && value > 0)) return now;
  }
}

/** The picture when nothing changes any more. */
async function settled(): Promise<Uint8ClampedArray> {
  for (let before = await drawn(); ; ) {
    for (let i = 0; i < QUIET; i++) await nextPicture();
    const now = await drawn();
    if (before.every((value, i) => value === now[i])) return now;
    before = now;
  }
}

async function main() {
  const loaded = new Promise((resolve) => frame.addEventListener("load", resolve));
  document.body.append(frame);
  await loaded;
  const words = await said();
  const failed = !words.at(-1)!.startsWith("frame ");
  const pixels = failed ? picture() : await (words.at(-1) === query.get("wanted") ? settled() : drawn());
  let text = "";
  for (let i = 0; i < pixels.length; i += 8192) text += String.fromCharCode(...pixels.subarray(i, i + 8192));
  return { words, picture: btoa(text) };
}

Object.assign(window, { report: main() });
