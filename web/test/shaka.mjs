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

/** Restrictions that leave one Representation. */
async function alone(id) {
  const document = new DOMParser().parseFromString(await (await fetch(mpd)).text(), "text/xml");
  const bandwidth = Number(document.querySelector(`Representation[id="${id}"]`).getAttribute("bandwidth"));
  return { minBandwidth: bandwidth, maxBandwidth: bandwidth };
}

async function report() {
  const errors = [];
  const id = query.get("only");
  shaka.polyfill.installAll();
  shaka.log.setLevel(shaka.log.Level.WARNING);
  const player = new shaka.Player();
  player.addEventListener("error", (event) => errors.push(`${event.detail.code}: ${event.detail.message}`));
  if (id) player.configure({ restrictions: await alone(id) });
  await player.attach(video);
  await player.load(mpd);
  const live = player.isLive();
  const representations = await Promise.all(player.getManifest().variants.map(({ video }) => listed(video)));
  if (id) await video.play().then(() => ended(video));
  const result = { live, duration: player.seekRange().end, representations, played: id && shown(video), errors };
  await player.destroy();
  return result;
}

window.report = report();
