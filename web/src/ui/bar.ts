// The row of buttons below the picture, and the time line above it.
import type { Desk } from "./desk.ts";
import { ICONS, iconButton, make, relabel, write } from "./dom.ts";
import type { Page } from "./menu.ts";
import { Timeline } from "./timeline.ts";
import { chosenRung, clock, qualityName, rungFigures, rungTitle, speedName } from "./words.ts";

const LIVE_S = 8;

export class Bar {
  readonly node: HTMLElement;
  readonly timeline: Timeline;
  readonly play = iconButton(ICONS.play, "Play");
  readonly #sound = iconButton(ICONS.mute, "Sound on");
  readonly #loop = iconButton(ICONS.loop, "Loop", { class: "wide" });
  readonly #home = iconButton(ICONS.home, "Back to the first view", { class: "home" });
  readonly #free = iconButton(ICONS.bounded, "Leave the viewing region", { class: "wide" });
  readonly #link = iconButton(ICONS.link, "Copy a link to this view", { class: "wide" });
  readonly #split = iconButton(ICONS.split, "Compare with the smallest", { class: "wider" });
  readonly #over = iconButton(ICONS.over, "Turn over", { class: "wider" });
  readonly info = iconButton(ICONS.info, "Figures");
  readonly #vr = iconButton(ICONS.vr, "Enter VR");
  readonly #full = iconButton(ICONS.full, "Full screen");
  readonly #settings = this.#opens(iconButton(ICONS.settings, "Settings"));
  readonly #speed = this.#opens(make("button", { type: "button", class: "text wide", "data-tip": "Speed" }));
  readonly #quality = this.#opens(make("button", { type: "button", class: "text wide", "data-tip": "Quality" }));
  readonly #chosen = document.createTextNode("Auto");
  readonly #shown = make("span");
  readonly #time = make("span", { class: "time" });
  readonly #live = make("button", { type: "button", class: "live" }, make("i"), "Live");

  constructor(
    readonly desk: Desk,
    readonly openMenu: (page: Page, opener: HTMLElement) => void,
  ) {
    this.timeline = new Timeline(desk);
    const left = [this.play, this.#sound, this.#live, this.#time, make("span", { class: "gap" })];
    const chosen = [this.#speed, this.#quality, this.#loop, this.#free, this.#home];
    const more = [this.#over, this.#split, this.#link, this.#settings, this.info, this.#vr, this.#full];
    const row = make("div", { class: "row" }, ...left, ...chosen, ...more);
    const attributes = { class: "bar", part: "controls", role: "group", "aria-label": "Controls" };
    this.node = make("div", attributes, this.timeline.node, row);
    this.#listen();
  }

  update(): void {
    const { player, orbit, ready, full, headset } = this.desk;
    const action = player.ended ? "again" : player.paused ? "play" : "pause";
    relabel(this.play, action, { again: "Play again", play: "Play", pause: "Pause" }[action]);
    const { still } = this.desk;
    for (const part of [this.play, this.timeline.node, this.#loop, this.#speed]) part.hidden = still;
    this.#split.hidden = !this.desk.comparable;
    this.#split.ariaPressed = String(this.desk.split);
    this.#sound.hidden = !player.hasSound;
    relabel(this.#sound, player.muted ? "mute" : "sound", player.muted ? "Sound on" : "Mute");
    this.#loop.ariaPressed = String(player.loop);
    this.#free.ariaPressed = String(orbit.free);
    if (orbit.free) relabel(this.#free, "free", "Stay inside the viewing region");
    else relabel(this.#free, "bounded", "Leave the viewing region");
    this.#vr.hidden = !headset;
    this.#vr.ariaPressed = String(player.vr);
    relabel(this.#vr, "vr", player.vr ? "Leave VR" : "Enter VR");
    relabel(this.#full, full ? "small" : "full", full ? "Leave full screen" : "Full screen");
    write(this.#speed, player.speed === 1 ? "1×" : speedName(player.speed));
    this.#speed.ariaLabel = `Speed: ${speedName(player.speed)}`;
    const shown = player.quality === "auto" && player.rung !== null ? this.desk.rungs[player.rung] : undefined;
    write(this.#chosen, qualityName(this.desk));
    write(this.#shown, shown ? rungTitle(this.desk, shown) : "");
    const chosen = chosenRung(this.desk);
    const figures = chosen && rungFigures(this.desk, chosen);
    this.#quality.ariaLabel = `Quality: ${qualityName(this.desk)}${figures ? ` · ${figures}` : ""}`;
    this.#liveness();
    for (const button of this.node.querySelectorAll("button")) button.disabled = !ready && button !== this.#full;
    this.timeline.node.ariaDisabled = String(!ready);
    this.updateTime();
  }

  updateTime(): void {
    const { duration } = this.desk.player;
    this.timeline.update();
    const times = duration > 0 ? `${clock(this.timeline.time, duration)} / ${clock(duration)}` : "";
    write(this.#time, this.desk.still ? "1 frame" : times);
  }

  #liveness(): void {
    const { player } = this.desk;
    this.#live.hidden = !player.live;
    if (!player.live) return;
    const newest = player.duration - player.currentTime < LIVE_S * Math.max(1, player.speed);
    this.#live.classList.toggle("now", newest);
    this.#live.ariaLabel = newest ? "Live: this is the newest" : "Live: go to the newest";
    this.#live.dataset.tip = newest ? "This is the newest" : "Go to the newest";
  }

  #opens(button: HTMLButtonElement): HTMLButtonElement {
    button.ariaHasPopup = "menu";
    button.ariaExpanded = "false";
    return button;
  }

  #listen(): void {
    const { desk } = this;
    this.#quality.append(this.#chosen, this.#shown);
    this.#link.hidden = !desk.linked;
    const click = (button: HTMLElement, run: () => void) =>
      button.addEventListener("click", run, { signal: desk.signal });
    const menu = (button: HTMLElement, page: Page) => click(button, () => this.openMenu(page, button));
    click(this.play, () => desk.toggle());
    click(this.#live, () => desk.seek(desk.player.duration));
    click(this.#sound, () => desk.toggleSound());
    click(this.#loop, () => desk.set("loop", !desk.player.loop));
    click(this.#free, () => desk.set("view-region", desk.orbit.free ? "bounded" : "free"));
    click(this.#split, () => desk.toggleSplit());
    click(this.#over, () => desk.turnOver());
    click(this.#home, () => desk.home());
    click(this.#link, () => desk.copyLink());
    click(this.info, () => desk.toggleInfo());
    click(this.#vr, () => desk.toggleVr());
    click(this.#full, () => desk.toggleFull());
    menu(this.#speed, "speed");
    menu(this.#quality, "quality");
    menu(this.#settings, "settings");
  }
}
