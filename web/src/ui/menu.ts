// The menu: quality, speed, policy, and what is on or off.
import type { Desk } from "./desk.ts";
import { icon, make, OTHERS } from "./dom.ts";
import { POLICIES, qualityName, rungFigures, rungTitle, speedName } from "./words.ts";

const SPEEDS = [0.25, 0.5, 0.75, 1, 1.25, 1.5, 2] as const;
export type Page = "settings" | "quality" | "speed" | "policy";

interface Item {
  label: string;
  note?: string;
  name?: string;
  colour?: string;
  /** One of several that exclude each other, or on and off; undefined: leads to something. */
  checked?: boolean;
  /** It does something, and leads nowhere. */
  ends?: boolean;
  kind?: "radio" | "checkbox";
  run(): void;
}

export class Menu {
  readonly node = make("div", { class: "menu", part: "menu", role: "menu", hidden: true });
  #page: Page | null = null;
  #first: Page = "settings";
  #opener: HTMLElement | null = null;
  #told: Desk["rungs"] = [];

  constructor(readonly desk: Desk) {
    const on = { signal: desk.signal };
    this.node.addEventListener("keydown", (event) => this.#key(event), on);
    this.node.addEventListener("focusout", (event) => this.#left(event), on);
  }

  get open(): boolean {
    return this.#page !== null;
  }

  toggle(page: Page, opener: HTMLElement): void {
    const again = this.#opener === opener && this.open;
    this.close();
    if (again) return;
    this.#opener = opener;
    this.#first = page;
    opener.ariaExpanded = "true";
    this.#show(page);
  }

  /** `back`: the keyboard goes back to the button that opened it. */
  close(back = false): void {
    if (!this.open) return;
    this.#page = null;
    this.node.hidden = true;
    this.node.replaceChildren();
    if (this.#opener) this.#opener.ariaExpanded = "false";
    if (back) this.#opener?.focus();
    this.#opener = null;
    this.desk.wake();
  }

  /** The figures of rungs have come: say them where people look. */
  update(): void {
    const news = this.#told !== this.desk.rungs && this.#told.some(({ kbps }) => !kbps);
    if (news && this.#page === "quality") this.#show(this.#page);
  }

  #show(page: Page): void {
    this.#page = page;
    this.#told = this.desk.rungs;
    const { title, items } = this.#content(page);
    const nodes = items.map((item) => this.#button(item));
    const head = make("div", { class: "head" }, title);
    const up = this.#above(page);
    if (up) {
      const attributes = { type: "button", role: "menuitem", "aria-label": "Back", tabindex: -1 };
      const leave = make("button", attributes, icon(OTHERS.back));
      leave.addEventListener("click", () => this.#show(up));
      head.prepend(leave);
    }
    this.node.replaceChildren(head, ...nodes);
    this.node.ariaLabel = title;
    this.node.hidden = false;
    (nodes.find((node) => node.ariaChecked === "true") ?? nodes[0])?.focus();
    this.desk.wake();
  }

  #above(page: Page): Page | null {
    if (page === "policy") return "quality";
    return this.#first === "settings" && page !== "settings" ? "settings" : null;
  }

  #content(page: Page): { title: string; items: Item[] } {
    if (page === "quality") return { title: "Quality", items: this.#qualities() };
    if (page === "policy") return { title: "How “Auto” chooses", items: this.#policies() };
    if (page === "speed") return { title: "Speed", items: this.#speeds() };
    return { title: "Settings", items: this.#settings() };
  }

  #settings(): Item[] {
    const { player, orbit, still, comparable, split } = this.desk;
    const timed: Item[] = [
      { label: "Speed", note: speedName(player.speed), run: () => this.#show("speed") },
      this.#toggle("Loop", player.loop, (on) => this.desk.set("loop", on)),
    ];
    return [
      { label: "Quality", note: qualityName(this.desk), run: () => this.#show("quality") },
      ...(still ? [] : timed),
      ...(comparable ? [this.#toggle("Compare with the smallest", split, () => this.desk.toggleSplit())] : []),
      this.#toggle("Leave the viewing region", orbit.free, (on) =>
        this.desk.set("view-region", on ? "free" : "bounded"),
      ),
      this.#action("Show all of the subject", "F", () => this.desk.showSubject()),
      this.#action("Turn over", "O", () => this.desk.turnOver()),
      this.#action("Begin here", "B", () => this.desk.beginHere()),
      this.#action("Back to where you began", "R", () => this.desk.home()),
      this.#action("Back to the first view of the scene", "Home", () => this.desk.home(true)),
      ...(this.desk.linked ? [this.#action("Copy a link to this view", "C", () => this.desk.copyLink())] : []),
      this.#action("Keys", "?", () => this.desk.toggleKeys()),
    ];
  }

  #toggle(label: string, checked: boolean, change: (on: boolean) => void): Item {
    return { label, checked, kind: "checkbox", run: () => this.#done(() => change(!checked)) };
  }

  #action(label: string, note: string, run: () => void): Item {
    return { label, note, ends: true, run: () => this.#done(run) };
  }

  #qualities(): Item[] {
    const { player, rungs } = this.desk;
    const shown = player.rung === null ? undefined : rungs[player.rung];
    const auto = player.quality === "auto";
    const note = auto && shown ? `now ${rungTitle(this.desk, shown)}` : "";
    return [
      { label: "Auto", note, checked: auto, run: this.#pick("auto") },
      ...this.#rungs(),
      ...(this.desk.still ? [] : [{ label: "How “Auto” chooses", run: () => this.#show("policy") }]),
    ];
  }

  /** Those that are worth their bytes, from the best to the worst. */
  #rungs(): Item[] {
    const { player, rungs, colours } = this.desk;
    const numbered = rungs.map((rung, number) => ({ rung, colour: colours[number] ?? "" }));
    numbered.sort((a, b) => b.rung.kbps - a.rung.kbps); // those that are not known yet stay: the first is the best
    return numbered
      .filter(({ rung }) => rung.onLadder)
      .map(({ rung, colour }) => ({
        label: rungTitle(this.desk, rung),
        note: rungFigures(this.desk, rung),
        name: rung.name,
        colour,
        checked: player.quality === rung.name,
        run: this.#pick(rung.name),
      }));
  }

  #pick(quality: string): () => void {
    return () => this.#done(() => this.desk.set("quality", quality));
  }

  #policies(): Item[] {
    const { player } = this.desk;
    return [...POLICIES].map(([name, label]) => ({
      label,
      checked: player.policy === name,
      run: () => this.#done(() => this.desk.set("policy", name)),
    }));
  }

  #speeds(): Item[] {
    const { player } = this.desk;
    const set = (speed: number) => this.#done(() => Object.assign(player, { speed }));
    return SPEEDS.map((speed) => {
      return { label: speedName(speed), checked: player.speed === speed, run: () => set(speed) };
    });
  }

  #done(change: () => void): void {
    change();
    this.close(true);
  }

  #button(item: Item): HTMLButtonElement {
    const { checked } = item;
    const role = checked === undefined ? "menuitem" : `menuitem${item.kind ?? "radio"}`;
    const node = make("button", { type: "button", role, tabindex: -1 });
    const mark = make("span", { class: "mark" });
    if (checked) mark.append(icon(OTHERS.check));
    if (checked !== undefined) node.ariaChecked = String(checked);
    const dot = item.colour ? [make("i", { class: "dot", style: `background: ${item.colour}` })] : [];
    node.append(mark, ...dot, make("span", { class: "label" }, item.label));
    for (const key of ["note", "name"] as const) if (item[key]) node.append(make("span", { class: key }, item[key]));
    if (checked === undefined && !item.ends) node.append(icon(OTHERS.next));
    node.addEventListener("click", () => item.run());
    return node;
  }

  #key(event: KeyboardEvent): void {
    const items = [...this.node.querySelectorAll("button")];
    const root = this.node.getRootNode() as ShadowRoot;
    const at = items.indexOf(root.activeElement as HTMLButtonElement);
    const steps: Readonly<Record<string, number>> = {
      ArrowDown: at + 1,
      ArrowUp: at - 1 + items.length,
      Home: 0,
      End: items.length - 1,
    };
    if (event.key === "Escape") this.close(true);
    else if (event.key in steps) items[steps[event.key] % items.length]?.focus();
    else if (event.key === "ArrowLeft") items.find((item) => item.ariaLabel === "Back")?.click();
    else if (event.key !== "ArrowRight") return;
    else if (items[at]?.querySelector(".mark + .label ~ svg")) items[at].click();
    event.preventDefault();
    event.stopPropagation();
  }

  /** The keyboard went elsewhere: a menu that nobody is in closes. */
  #left(event: FocusEvent): void {
    const to = event.relatedTarget;
    if (to instanceof Node && !this.node.contains(to) && to !== this.#opener) this.close();
  }
}
