// Mouse, pen and fingers on the picture: what they do to the camera.
import type { Orbit, Push } from "./orbit.ts";

/** Radians that a drag over the height of the picture turns. */
const TURN = Math.PI;
/** ln of the distance that a line of a wheel, and a pixel of one, is worth. */
const WHEEL_LINE = 0.05;
const WHEEL_PIXEL = 0.0015;
/** Of a trackpad that is pinched, which browsers report as a wheel with the control key. */
const WHEEL_PINCH = 0.01;
const WHEEL_MOST = 0.4;
/** A tap stays within so many pixels and milliseconds; two make a double tap within DOUBLE_MS. */
const TAP_PX = 8;
const TAP_MS = 350;
const DOUBLE_MS = 320;
/** The motion of the last milliseconds of a drag goes on by itself. */
const FLING_MS = 90;

interface Finger {
  x: number;
  y: number;
  readonly startX: number;
  readonly startY: number;
  readonly time: number;
}

export interface GestureEvents {
  moved(): void;
  tap(event: PointerEvent): void;
  doubleTap(event: PointerEvent): void;
}

export class Gestures {
  readonly #fingers = new Map<number, Finger>();
  #panning = false;
  /** More than one finger was down, or it went too far for a tap. */
  #dragged = false;
  /** It went up or down alone: the page scrolls. */
  #scrolls = false;
  #trail: { time: number; push: Push }[] = [];
  #lastTap: { time: number; x: number; y: number } | null = null;

  constructor(
    readonly area: HTMLElement,
    readonly orbit: () => Orbit,
    readonly events: GestureEvents,
    /** Whether nothing here scrolls the page. */
    readonly captures: () => boolean,
    signal: AbortSignal,
  ) {
    area.addEventListener("pointerdown", (event) => this.#down(event), { signal });
    area.addEventListener("pointermove", (event) => this.#move(event), { signal });
    area.addEventListener("pointerup", (event) => this.#up(event), { signal });
    area.addEventListener("pointercancel", (event) => this.#lift(event), { signal });
    area.addEventListener("lostpointercapture", (event) => this.#lift(event), { signal });
    area.addEventListener("contextmenu", (event) => event.preventDefault(), { signal });
    area.addEventListener("wheel", (event) => this.#wheel(event), { signal, passive: false });
  }

  #down(event: PointerEvent): void {
    this.area.setPointerCapture(event.pointerId);
    const { clientX: x, clientY: y, timeStamp: time } = event;
    if (this.#fingers.size === 0) this.#dragged = false;
    this.#fingers.set(event.pointerId, { x, y, startX: x, startY: y, time });
    this.#panning = event.button !== 0 || event.shiftKey || this.#fingers.size > 1;
    this.#dragged ||= this.#fingers.size > 1 || event.button !== 0;
    this.#scrolls = false;
    this.#trail = [];
    this.orbit().held = true;
    this.orbit().stop();
  }

  #move(event: PointerEvent): void {
    const finger = this.#fingers.get(event.pointerId);
    if (!finger) return;
    const { clientX: x, clientY: y } = event;
    if (!this.#dragged) {
      const [right, down] = [Math.abs(x - finger.startX), Math.abs(y - finger.startY)];
      this.#dragged = Math.hypot(right, down) > TAP_PX;
      this.#scrolls = this.#dragged && down > right && event.pointerType === "touch" && !this.captures();
    }
    const push = this.#pushOf(finger, event.pointerId, x, y);
    Object.assign(finger, { x, y });
    if (!this.#dragged || this.#scrolls) return;
    this.orbit().move(push);
    this.#trail.push({ time: event.timeStamp, push });
    this.#trail = this.#trail.filter((one) => event.timeStamp - one.time < FLING_MS);
    this.events.moved();
  }

  /** Finds the push of a finger that goes to (x, y): the scene goes with it. */
  #pushOf(finger: Finger, id: number, x: number, y: number): Push {
    const height = this.area.clientHeight || 1;
    const right = (x - finger.x) / height;
    const down = (y - finger.y) / height;
    const other = [...this.#fingers].find(([key]) => key !== id)?.[1];
    if (!other) return this.#panning ? { panRight: -right, panUp: down } : { right: -TURN * right, up: TURN * down };
    const [before, after] = [finger, { x, y }].map((one) => Math.max(1, Math.hypot(one.x - other.x, one.y - other.y)));
    return { panRight: -right / 2, panUp: down / 2, nearer: Math.log(after / before) };
  }

  #up(event: PointerEvent): void {
    const finger = this.#fingers.get(event.pointerId);
    this.#lift(event);
    if (!finger || this.#fingers.size > 0) return;
    if (!this.#dragged) {
      if (event.timeStamp - finger.time < TAP_MS) this.#tapped(event);
      return;
    }
    const recent = this.#trail.filter((one) => event.timeStamp - one.time < FLING_MS);
    const speed: Push = {};
    for (const { push } of recent) {
      for (const name of Object.keys(push) as (keyof Push)[]) {
        speed[name] = (speed[name] ?? 0) + ((push[name] ?? 0) * 1000) / FLING_MS;
      }
    }
    this.orbit().fling(speed);
    this.events.moved();
  }

  #lift(event: PointerEvent): void {
    if (!this.#fingers.delete(event.pointerId)) return;
    if (this.#fingers.size > 0) this.#trail = [];
    this.orbit().held = this.#fingers.size > 0;
    this.events.moved();
  }

  #tapped(event: PointerEvent): void {
    const last = this.#lastTap;
    const near = last && Math.hypot(event.clientX - last.x, event.clientY - last.y) < 4 * TAP_PX;
    const double = near && event.timeStamp - last.time < DOUBLE_MS;
    this.#lastTap = double ? null : { time: event.timeStamp, x: event.clientX, y: event.clientY };
    if (double) this.events.doubleTap(event);
    else this.events.tap(event);
  }

  #wheel(event: WheelEvent): void {
    if (!event.ctrlKey && !this.captures() && !this.area.matches(":focus")) return;
    event.preventDefault();
    const unit = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? WHEEL_PIXEL : WHEEL_LINE;
    const wanted = -event.deltaY * (event.ctrlKey && event.deltaMode === 0 ? WHEEL_PINCH : unit);
    this.orbit().nudge({ nearer: Math.max(-WHEEL_MOST, Math.min(wanted, WHEEL_MOST)) });
    this.events.moved();
  }
}
