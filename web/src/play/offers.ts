// What a player asks the tables of a package.
import type { Count } from "../format/index.ts";
import type { Root, Segment, Tile } from "../format/types.ts";

/** The tables of a package, as far as a player looks at them: `Tables` of the format, or numbers alone.
 *
 * Groups, segments, tiles, units and files are counted from 0. Questions about a group whose table is not there (`has`) throw.
 */
export interface Offers {
  readonly root: Pick<Root, "frame_rate" | "live" | "tiers" | "tiles" | "frames"> & {
    readonly views: Pick<Root["views"], "reference">;
    readonly qualities: readonly Pick<Root["qualities"][number], "id">[];
    readonly levels: readonly Pick<Root["levels"][number], "id" | "tiers">[];
  };
  readonly rootBytes: number;
  readonly index: {
    readonly groups: number;
    readonly segments: number;
    entry(group: number): { start: number; stop: number; firstSegment: number; segments: number };
    pagesTo(count: Count, number: number): Iterable<string>;
    missingPages(segment: number, there: (path: string) => boolean): string[];
    leadsTo(segment: number): boolean;
    hasPage(path: string): boolean;
    guessSpan(segment: number): { start: number; stop: number };
  };
  has(group: number): boolean;
  segment(segment: number): Pick<Segment, "start" | "stop"> & { levels: readonly { psnr: readonly number[] }[] };
  groupOf(segment: number): number;
  /** Gaussians of a group in each key unit. */
  rows(group: number): readonly number[];
  /** Where the tiles of a group are. */
  boxes(group: number): readonly Pick<Tile, "low" | "high">[];
  /** The key units that viewers of a level fetch of some tiles, by default of all. */
  unitsOf(level: number, tiles?: readonly number[]): number[];
  /** The group whose rows a group keeps; null: none. */
  base(group: number): number | null;
  keyFiles(group: number, unit: number, quality: number): string[];
  /** Those of the key unit of the base whose rows a key unit keeps. */
  keptFiles(group: number, unit: number, quality: number): string[];
  stateFiles(segment: number, level: number, tiles?: readonly number[]): string[];
  entry(path: string): { bytes: number };
}
