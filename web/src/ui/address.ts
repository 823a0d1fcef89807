// A moment in words that an address can hold: t=1.5&view=px,py,pz,fx,fy,fz[,ux,uy,uz]&rung=Q0+L1&speed=0.5
import { length, makesView, minus, unit, type Vector } from "../format/vector.ts";

/** From where to what, world units; `up` where it is not that of the scene. */
export interface Stance {
  readonly position: Vector;
  readonly focus: Vector;
  readonly up?: Vector;
}

export interface Moment {
  /** Seconds. */
  t?: number;
  view?: Stance;
  rung?: string;
  speed?: number;
}

const EXPECTED = {
  t: "seconds",
  view: "six or nine numbers",
  rung: "a rung",
  speed: "a number above 0",
} as const;

const DIGITS = 7;
/** After the point: the time of a frame is told so well that it is not that of the one before. */
const TIME_DIGITS = 9;

const isName = (name: string): name is keyof Moment => Object.hasOwn(EXPECTED, name);

/** A number in full; NaN for anything else, such as nothing. */
const numberOf = (text: string): number => (/^[-+.\de]+$/i.test(text) ? Number(text) : Number.NaN);

function stanceOf(text: string): Stance | undefined {
  const numbers = text.split(",").map(numberOf);
  if (![6, 9].includes(numbers.length) || !numbers.every(Number.isFinite)) return undefined;
  const [position, focus, up] = [0, 3, 6].map((i) => numbers.slice(i, i + 3) as unknown as Vector);
  const ahead = minus(focus, position);
  if (numbers.length === 6) return length(ahead) > 0 ? { position, focus } : undefined;
  return makesView(ahead, up) ? { position, focus, up: unit(up) } : undefined;
}

function readPart(name: keyof Moment, text: string): Moment[keyof Moment] {
  if (name === "rung") return text || undefined;
  if (name === "view") return stanceOf(text);
  const number = numberOf(text);
  return Number.isFinite(number) && (name === "t" ? number >= 0 : number > 0) ? number : undefined;
}

/** What an address says after its #, and a line for each part of it that says nothing. */
export function readAddress(text: string): { moment: Moment; wrong: string[] } {
  const moment: Record<string, unknown> = {};
  const wrong: string[] = [];
  for (const part of text.split("&").filter(Boolean)) {
    const [name, ...rest] = part.split("=");
    try {
      const value = isName(name) ? readPart(name, decodeURIComponent(rest.join("="))) : undefined;
      if (value !== undefined) moment[name] = value;
      else wrong.push(`${part}: expected ${isName(name) ? EXPECTED[name] : Object.keys(EXPECTED).join(", ")}`);
    } catch {
      wrong.push(`${part}: expected text`);
    }
  }
  return { moment, wrong };
}

/** Numbers in short; what is nothing beside the largest of them is 0. */
function inShort(numbers: readonly number[]): string {
  const step = 10 ** (Math.ceil(Math.log10(Math.max(...numbers.map(Math.abs)))) - DIGITS);
  return numbers.map((x) => Number((step > 0 ? step * Math.round(x / step) : x).toPrecision(DIGITS))).join(",");
}

export function writeAddress({ t, view, rung, speed }: Moment): string {
  const parts = {
    t: t === undefined ? "" : String(Number(t.toFixed(TIME_DIGITS))),
    view: view ? [view.position, view.focus, ...(view.up ? [view.up] : [])].map(inShort).join(",") : "",
    rung: encodeURIComponent(rung ?? "").replace("%2B", "+"),
    speed: speed === undefined ? "" : inShort([speed]),
  };
  return Object.entries(parts)
    .filter(([, value]) => value)
    .map((part) => part.join("="))
    .join("&");
}
