// Made by tests/makers/probe_clip.py, with the project's encoder, and checked with its decoder.

/** Blocks in a line, lines of blocks, and samples either side of a block: the picture is 256 x 256. */
export const PROBE_BLOCKS = 16;

/** A coded IDR picture with its parameter sets, as in an .m4s file; block (x, y) has luma 16 y + x in every sample. */
export const PROBE_CLIP =
  "AAAAGGdkAA2stAgENNkAAAMAAQAAAwAwDxQqoAAAAAVo7wFvLAAAAOZliISv/vexj4FN1bhFjQMJygx/KCoKeQyWyaaqjfUwAAhpfn0flKRoCAUH" +
  "qkpxLNLE6h7vdI9pr5lZOu3uhYVFbFqkUIGC2CIpyO2NEa6cKVQAZyrsIVDVVpPbI4JKluGty+SWjBzjLb81AfYNYZhxweI70UeYHxem6r5xaUYY" +
  "WXIrtic2xMxRZMiWvMLNa73W4CeaB4Ph29b1SVh4wMEZEd6n0etRbzzDF2aKMMLMwmJYnV/W90jGrxwPi9N1XzgHVXA8Hw7et6pKw8YGCdiO9T6P" +
  "Wot55hi7PlGGFmYTEsTq/re8HQ==";
