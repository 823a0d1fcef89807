// <airgs-player src="…">: a player of streamed Gaussian splat video with controls, for any page. Its attributes, each with
// a property of the same name, methods and colours are those of docs/browser.md. Beside them, the property `player` is
// the Player, or null. Events are those of the Player and do not bubble. Parts are frame, picture, poster, controls,
// timeline, menu, panel, card.
import { Player } from "./airgs.ts";
import type { PlayerSettings } from "./ui/desk.ts";
import { PlayerElement } from "./ui/element.ts";

export * from "./airgs.ts";

export class AirgsPlayer extends PlayerElement {
  override create(canvas: HTMLCanvasElement, settings: PlayerSettings): Player {
    return new Player(canvas, settings);
  }
}

declare global {
  interface HTMLElementTagNameMap {
    "airgs-player": AirgsPlayer;
  }
}

if (globalThis.customElements && !customElements.get("airgs-player"))
  customElements.define("airgs-player", AirgsPlayer);
