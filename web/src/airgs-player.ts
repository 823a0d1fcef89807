// <airgs-player src="…">: a player of streamed Gaussian splat video with controls, for any page.
//
//     <script type="module" src="airgs-player.js"></script>
//     <airgs-player src="scene.airgs/" controls autoplay loop></airgs-player>
//
// Attributes, each with a property of the same name:
//     src            address of a package: the folder that airgs.json is in
//     poster         picture to show until the first one is there
//     autoplay       play as soon as there is something to play
//     loop           begin again at the end
//     capture        wheel and fingers over the picture never scroll the page; without it, the wheel does until the
//                    picture was clicked (with Ctrl it zooms at once), and so does a finger that goes up or down
//     controls       show the controls; looking around works without them
//     policy         how "auto" chooses: robust-mpc, throughput, bola, paper or paper-literal (both also with -no-cliff)
//     budget         most Gaussians that are fetched and shown at once, for small devices; any number without it
//     all-tiles      fetch all of a scene that is cut into tiles, not only those expected in sight
//     quality        auto (the default), or the name of a rung
//     view-region    bounded (the default): viewers stay where quality is promised; free: they may leave
//                    (the property is viewRegion)
//
// Properties: player (the Player, or null), paused, ended, duration, currentTime. Methods: play(), pause(), seek(seconds).
// Events, as of the Player: open, firstpicture, rung, stall, resume, time, progress, ended, pause, play, problem
// (detail: {message, fatal}), lost, restored. They do not bubble.
//
// It is a block, as wide as there is room and 16:9, unless CSS says otherwise. Colours: --airgs-accent, --airgs-background,
// --airgs-panel. Parts: frame, picture, poster, controls, timeline, menu, panel, card.
import { Player } from "./airgs.ts";
import type { PlayerLike, PlayerSettings } from "./ui/desk.ts";
import { PlayerElement } from "./ui/element.ts";

export * from "./airgs.ts";

export class AirgsPlayer extends PlayerElement {
  override create(canvas: HTMLCanvasElement, settings: PlayerSettings): PlayerLike {
    return new Player(canvas, settings);
  }
}

if (globalThis.customElements && !customElements.get("airgs-player"))
  customElements.define("airgs-player", AirgsPlayer);
