/** Why a package, or a file of it, is refused: the reasons of FORMAT.md, section 10. */
export type Reason =
  | "not_json"
  | "too_large"
  | "unknown_version"
  | "unknown_field"
  | "missing_field"
  | "wrong_type"
  | "bad_value"
  | "missing_entry"
  | "missing_file"
  | "size_mismatch"
  | "hash_mismatch"
  | "bad_sidecar"
  | "bad_sound"
  | "count_mismatch"
  | "bad_picture";

/** A package that breaks the format: one line that says where, what was expected and what came. */
export class FormatError extends Error {
  override name = "FormatError";

  constructor(
    readonly reason: Reason,
    readonly where: string,
    readonly detail: string,
  ) {
    super(`${where}: ${detail} (${reason})`);
  }
}
