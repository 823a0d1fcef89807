// Loads the MPD of the query (mpd=…) with shaka-player, reports everything it parsed, and plays one of its
// Representations (only=ID; all are listed, and none is played, without).
import { ended, shown } from "./video.mjs";

const query = new URLSearchParams(location.search);
const mpd = new URL(query.get("mpd"), location).href;
const video = document.querySelector("video");

async function listed(stream) {
  await stream.createSegmentIndex();
  const segments = [];
  stream.segmentIndex.forEachTopLevelReference((segment) => {
    const { startTime: start, initSegmentReference: init } = segment; // its end is stretched to the next one's start
    segments.push({ start, urls: segment.getUris(), init: init.getUris() });
  });
  return { id: stream.originalId, set: stream.groupId, segments };
}

/** Loads the MPD again with one Representation alone. */
async function play(player, id) {
  const { bandwidth } = player.getVariantTracks().find((track) => track.originalVideoId === id);
  player.configure({ restrictions: { minBandwidth: bandwidth, maxBandwidth: bandwidth } });
  await player.load(mpd);
  await video.play();
  await ended(video);
  return shown(video);
}

async function report() {
  const errors = [];
  shaka.polyfill.installAll();
  shaka.log.setLevel(shaka.log.Level.WARNING);
  const player = new shaka.Player();
  player.addEventListener("error", (event) => errors.push(`${event.detail.code}: ${event.detail.message}`));
  await player.attach(video);
  await player.load(mpd);
  const representations = await Promise.all(player.getManifest().variants.map(({ video }) => listed(video)));
  const duration = player.seekRange().end;
  const live = player.isLive();
  const played = query.has("only") ? await play(player, query.get("only")) : null;
  await player.destroy();
  return { live, duration, representations, played, errors };
}

window.report = report();
