// What a video element showed, for the pages of both DASH players.

let seeks = 0; // of the page's video, by a player or by Chromium, which goes back where an MPD ends a tick early
document.querySelector("video").addEventListener("seeking", () => (seeks += 1));

/** Waits for the element to play to its end. Chromium now and then is at the end without an `ended` event. */
export async function ended(video) {
  while (!video.ended) await new Promise((resolve) => setTimeout(resolve, 20));
}

/**
 * Counts of frames that were decoded (after a seek some are decoded again), of corrupt ones and of seeks, the size, and
 * how grey the last picture is: largest difference of channels, range of luma.
 */
export function shown(video) {
  const canvas = new OffscreenCanvas(video.videoWidth, video.videoHeight);
  const context = canvas.getContext("2d");
  context.drawImage(video, 0, 0);
  const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
  let [colour, darkest, brightest] = [0, 255, 0];
  for (let at = 0; at < data.length; at += 4) {
    const [low, high] = [Math.min(...data.subarray(at, at + 3)), Math.max(...data.subarray(at, at + 3))];
    [colour, darkest, brightest] = [Math.max(colour, high - low), Math.min(darkest, low), Math.max(brightest, high)];
  }
  const { totalVideoFrames: frames, corruptedVideoFrames: corrupted } = video.getVideoPlaybackQuality();
  const { videoWidth: width, videoHeight: height, duration, currentTime: stopped } = video;
  return { frames, corrupted, seeks, width, height, duration, stopped, colour, darkest, brightest };
}
