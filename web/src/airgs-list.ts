// The server's list of packages: files are dropped on it, which the server encodes; a scene plays when it is a package.

const zone = document.querySelector("label"); // there is none where nothing may be dropped
const said = document.querySelector("output");
const cards = () => [...document.querySelectorAll("li > a")].map((card) => card.getAttribute("href")!);
const busy = () => document.querySelector("progress");
/** Pages of what was dropped; null: of the one scene that is encoded, where there is nothing else to see. */
const awaited = new Set<string | null>(!cards().length && busy() ? [null] : []);
let sending = 0;

/** Shows what the server has now, and goes to the scene if it is the only one that somebody waits for. */
export async function look(): Promise<void> {
  try {
    const page = new DOMParser().parseFromString(await (await fetch("/")).text(), "text/html");
    for (const part of ["section div", "ul"]) {
      const [old, fresh] = [document, page].map((one) => one.querySelector(part)!);
      if (old.innerHTML !== fresh.innerHTML) old.replaceWith(fresh);
    }
  } catch {
    for (const bar of document.querySelectorAll("progress"))
      bar.parentElement!.textContent = "the server does not answer";
  }
  const [page] = [...awaited].map((one) => one ?? (busy() || cards().length > 1 ? "" : cards()[0]));
  if (awaited.size === 1 && !sending && cards().includes(page)) {
    awaited.clear();
    location.assign(page);
  }
}

/** Sends a file; why it is refused stays on the page. */
async function send(file: File, isFolder: boolean): Promise<void> {
  const line = said!.appendChild(document.createElement("div"));
  const most = Number(zone!.querySelector("input")!.dataset.most);
  line.textContent = `sending ${file.name}`;
  try {
    if (isFolder) throw new Error(`${file.name}: expected a file, got a folder: start airgs-serve with it`);
    if (file.size > most) throw new Error(`${file.name}: expected at most ${(most / 1e9).toFixed(1)} GB`);
    const answer = await fetch(`/?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
    if (!answer.ok) throw new Error(await answer.text());
    awaited.add(answer.headers.get("Location")!);
    line.remove();
  } catch (error) {
    line.textContent =
      error instanceof TypeError ? `${file.name}: the server does not answer` : (error as Error).message;
  }
}

async function sendAll(files: FileList, areFolders: boolean[] = []): Promise<void> {
  said!.replaceChildren();
  sending++;
  for (const [number, file] of [...files].entries()) await send(file, areFolders[number] ?? false);
  sending--;
  await look();
}

if (zone) {
  zone.onchange = (event) => sendAll((event.target as HTMLInputElement).files!);
  for (const kind of ["dragover", "dragleave", "drop"] as const)
    document.addEventListener(kind, (event) => {
      event.preventDefault();
      zone.classList.toggle("over", kind === "dragover");
      const { files, items } = event.dataTransfer!;
      if (kind === "drop")
        sendAll(
          files,
          [...items].map((item) => item.webkitGetAsEntry()?.isDirectory ?? false),
        );
    });
}
setInterval(() => busy() && look(), 1000);
