// Plays the MPD of the query (mpd=…) with dash.js to its end: all of it, or one Representation (only=ID). Reports the
// AdaptationSets that it found, what it fetched and what was shown.
import { ended, shown } from "./video.mjs";

const query = new URLSearchParams(location.search);
const mpd = new URL(query.get("mpd"), location).href;
const video = document.querySelector("video");
const { MediaPlayer, Debug } = dashjs;
const { ERROR, FRAGMENT_LOADING_COMPLETED, STREAM_INITIALIZED } = MediaPlayer.events;

const SETTINGS = {
  debug: { logLevel: Debug.LOG_LEVEL_WARNING },
  streaming: { utcSynchronization: { enabled: false } }, // it would ask a server on the internet for the time
};

const listed = (track) => ({
  set: track.id,
  role: track.supplementalProperties.map(({ value }) => value),
  representations: track.bitrateList.map(({ id }) => id),
});

function fragment({ request }) {
  const { type, url, startTime: start, duration, representation } = request;
  return { id: representation.id, type, url, start, end: start + duration };
}

async function report() {
  const [errors, fragments] = [[], []];
  let first = null; // what the first MPD says: later ones of a live presentation may differ
  const player = MediaPlayer().create();
  player.updateSettings(SETTINGS);
  player.on(ERROR, ({ error }) => errors.push(`${error.code}: ${error.message}`));
  player.on(FRAGMENT_LOADING_COMPLETED, (event) => fragments.push(fragment(event)));
  player.on(STREAM_INITIALIZED, () => {
    first ??= { live: player.isDynamic(), sets: player.getTracksFor("video").map(listed) };
  });
  if (query.has("only")) player.registerCustomCapabilitiesFilter(({ id }) => id === query.get("only"));
  player.initialize(video, mpd, true);
  await ended(video);
  const result = { ...first, duration: player.duration(), fragments, played: shown(video), errors };
  player.destroy();
  return result;
}

window.report = report();
