// What the parts of the element know of it, and what it asks of a player.
import type { PlayerOptions } from "../play/playback.ts";
import type { Player } from "../play/player.ts";
import { readAddress, writeAddress } from "./address.ts";
import type { View } from "./view.ts";

/** `Player`, or one that only pretends, in tests. */
export type PlayerLike = EventTarget &
  Pick<Player, "open" | "play" | "pause" | "seek" | "close" | "paused" | "ended" | "live" | "loop" | "speed"> &
  Pick<Player, "currentTime" | "duration" | "fps" | "buffered" | "rungs" | "rung" | "quality" | "policy"> &
  Pick<Player, "region" | "camera" | "stats" | "resize" | "vr" | "enterVr" | "leaveVr"> &
  Pick<Player, "hasSound" | "muted" | "volume">;

export type PlayerSettings = Pick<PlayerOptions, "policy" | "loop" | "budget" | "muted" | "volume">;

/** A part of the time line, in seconds, and the number of its rung. */
export type Part = Player["buffered"][number];

/** What a player tells. */
export const EVENTS =
  "open poster firstpicture rung stall resume time progress ended vr volumechange pause play problem lost restored".split(
    " ",
  );

/** The view as its parts know it. */
export type Desk = Readonly<
  Pick<View, "player" | "orbit" | "signal" | "rungs" | "colours" | "ready" | "full" | "headset" | "scale" | "picture"> &
    Pick<View, "toggle" | "seek" | "skip" | "frame" | "home" | "beginHere" | "turnOver" | "linked" | "copyLink"> &
    Pick<View, "toggleFull" | "toggleVr" | "toggleInfo" | "toggleSound" | "set" | "wake">
>;

/** The moment that is shown, as text. */
export function momentOf({ player, orbit }: Desk): string {
  const { currentTime: t, quality, speed } = player;
  const [rung, other] = [quality === "auto" ? {} : { rung: quality }, speed === 1 ? {} : { speed }];
  return writeAddress({ t, view: orbit.stance, ...rung, ...other });
}

/** Go to a moment that is told as text; a line for each part of it that cannot be done. */
export function goTo(desk: Desk, text: string): string[] {
  const { player, orbit, rungs } = desk;
  const { moment, wrong } = readAddress(text);
  const { t, view, rung, speed } = moment;
  if (t !== undefined && t > player.duration) wrong.push(`t=${t}: expected at most ${player.duration.toFixed(3)} s`);
  else if (t !== undefined) player.seek(t);
  const names = ["auto", ...rungs.map(({ name }) => name)];
  if (rung && !names.includes(rung)) wrong.push(`rung=${rung}: expected one of ${names.join(", ")}`);
  else if (rung) desk.set("quality", rung);
  if (speed) player.speed = speed;
  if (view) {
    orbit.begin(view);
    if (orbit.outside && !orbit.free) desk.set("view-region", "free");
  }
  return wrong;
}

/** Copies a link to the moment that is shown, or makes it the address of the page; says which. */
export async function copyLink(desk: Desk): Promise<string> {
  const link = `#${momentOf(desk)}`;
  try {
    await navigator.clipboard.writeText(location.href.replace(/#.*|$/, link));
    return "Copied: a link to this view.";
  } catch {
    history.replaceState(null, "", link);
    return "The address of the page is now a link to this view.";
  }
}
