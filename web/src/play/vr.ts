// A headset in the place of the page, by WebXR: its frames show what is due, once for each eye. Both eyes take one order
// in depth, that of whom is between them.
import type { Playback } from "./playback.ts";
import { eyeCamera, seatOf, viewFrom } from "./seat.ts";

/** Puts the headset on; `left`: it is off again, `select`: a trigger was pulled. Throws DOMException without one. */
export async function enter(playback: Playback, left: () => void, select: () => void): Promise<void> {
  const { screen } = playback;
  const gl = screen.canvas.getContext("webgl2");
  if (!navigator.xr || !gl) return;
  await gl.makeXRCompatible();
  const session = await navigator.xr.requestSession("immersive-vr");
  playback.headset = session;
  session.addEventListener("end", () => {
    playback.headset = null;
    left();
  });
  session.addEventListener("select", select);
  try {
    const baseLayer = new XRWebGLLayer(session, gl, { alpha: false, antialias: false, depth: false });
    await session.updateRenderState({ baseLayer });
    show(playback, session, baseLayer, await session.requestReferenceSpace("local"));
  } catch (error) {
    playback.headset?.end();
    throw error;
  }
}

function show(playback: Playback, session: XRSession, layer: XRWebGLLayer, room: XRReferenceSpace): void {
  const { screen } = playback;
  const seat = seatOf(playback.media.tables.root);
  playback.resize(layer.framebufferWidth, layer.framebufferHeight);
  const look = ({ transform, views }: XRViewerPose): boolean => {
    screen.look(viewFrom(seat, transform.matrix));
    const eyes = views.flatMap((view) => {
      const { x, y, width, height } = layer.getViewport(view) ?? { x: 0, y: 0, width: 0, height: 0 };
      if (!width || !height) return []; // an eye that the headset leaves out
      const camera = eyeCamera(seat, view.transform.matrix, view.projectionMatrix, width, height);
      return [{ camera, surface: { framebuffer: layer.framebuffer, x, y, width, height } }];
    });
    return screen.drawEyes(eyes);
  };
  const onFrame: XRFrameRequestCallback = (_, frame) => {
    session.requestAnimationFrame(onFrame);
    const pose = frame.getViewerPose(room);
    playback.step(() => pose !== undefined && look(pose));
  };
  session.requestAnimationFrame(onFrame);
}
