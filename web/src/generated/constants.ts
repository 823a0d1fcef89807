// Made by python -m tools.typescript from airgs_codec: the modules named below say what each is.

// airgs_codec.package.tables
export const VERSION = 6;
export const PAGE = 64;
export const DIGEST = 32;
export const BLOCK = 16;
export const STATIC = 255;
export const LEAST_CLASS = -128;
export const MOST_CLASS = 127;
export const MOST_WIDER = 255;
export const TRANSFORM_UNITS = 32767;
export const LIMITS = {"bits": 21, "side": 4096, "macroblocks": 36864, "pages": 128} as const;
export const MIN_PICTURE_SIDE = 64;
export const MAX_POSTER_BYTES = 20000;
export const PACKETS = 50;

// airgs_codec.package.parse
export const MAX_TABLE_BYTES = 16777216;
export const MAX_VALUES = 2097152;

// airgs_codec.package.layout
export const ROOT_PATH = "airgs.json";
export const INIT_PATH = "init.mp4";
export const POSTER_PATH = "poster.jpg";
export const SOUND_INIT_PATH = "sound/init.m4a";
export const PATHS = [["^keyframe/T(0|[1-9]\\d?)/([1-9]\\d{0,6})\\.bin$", "sidecar"], ["^keyframe/T(0|[1-9]\\d?)/Q(0|[1-9]\\d?)/([1-9]\\d{0,6})\\.m4s$", "keyframe"], ["^delta/L(0|[1-9]\\d?)/([1-9]\\d{0,6})\\.m4s$", "delta"], ["^sound/([1-9]\\d{0,6})\\.m4a$", "sound"], ["^group/([1-9]\\d{0,6})\\.json\\.gz$", "group"], ["^index/([1-9])/([1-9]\\d{0,6})\\.json$", "page"]] as const;
export const KEYFRAME_ATTRIBUTES = ["log_scales", "quaternions", "opacity", "colour"] as const;
export const KEYFRAME_AT = {"log_scales": 0, "quaternions": 3, "opacity": 6, "colour": 7} as const;
export const KEYFRAME_CHANNELS = ["log_scales", "log_scales", "log_scales", "quaternions", "quaternions", "quaternions", "opacity"] as const;
export const DELTA_ATTRIBUTES = ["means", "log_scales", "quaternions", "opacity", "colour"] as const;
export const DELTA_AT = {"means": 0, "log_scales": 3, "quaternions": 6, "opacity": 9, "colour": 10} as const;
export const DELTA_CHANNELS = ["means", "means", "means", "log_scales", "log_scales", "log_scales", "quaternions", "quaternions", "quaternions", "opacity"] as const;

// airgs_codec.package.region
export const LEAST_SCALE = 1e-06;
export const MOST_SCALE = 1000000.0;
export const WORLD_TOLERANCE = 1e-05;
export const AGREEMENT = 0.1;
export const LEVELLING = 100;
export const FORGIVEN_DEGREES = 0.0001;
export const FORGIVEN_SHARE = 1e-09;

// airgs_codec.scene.gaussians
export const SMALL_ANGLE = 1e-08;
export const SH_C0 = 0.28209479177387814;

// airgs_codec.coding.atlas
export const GREY = 128;

// airgs_codec.coding.channels
export const OPACITY_MARGIN = 9.5367431640625e-07;

// airgs_codec.coding.escapes
export const ESCAPE_UNIT = 128;

// airgs_codec.coding.rangecoder
export const RANGE_START = 4294967295;
export const RANGE_LEAST = 16777216;
export const CHANCE_HALF = 32768;
export const CHANCE_LEAST = 16;
export const END_BYTES = 5;
export const MODEL_MEMORY = 60;
export const MODEL_CONTEXTS = 16;
export const LENGTH_BITS = 6;
export const MODELLED_BITS = 3;

// airgs_codec.media.mp4
export const BOX_HEADER = 8;
export const OWN_UUID = "fe15461879f4528284085db6297a522f";
export const TRUN = {"offset": 1, "first": 4, "duration": 256, "size": 512, "composition": 2048} as const;
export const TFHD = {"base": 1, "description": 2, "duration": 8, "size": 16} as const;
export const PACKET_TICKS = 960;
export const SOUND_RATE = 48000;
export const WARM_UP = 4;

// airgs_codec.media.h264
export const DARKEST = 16;
export const BRIGHTEST = 235;

// airgs_codec.media.metrics
export const PSNR_CAP = 100.0;

// airgs_codec.render.cpu
export const FAR = 1e+18;
export const DILATION = 0.3;

// airgs_codec.render.cpu_kernels
export const MARGIN = 0.15;
export const ALPHA_MAX = 0.9990000128746033;
export const SH_C1 = 0.4886025119029199;
export const SH_C2: readonly number[] = [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
export const SH_C3: readonly number[] = [-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658, 1.445305721320277, -0.5900435899266435];

// airgs_codec.play.policies
export const DEFAULT_POLICY = "robust-mpc";
export const SAFETY = 0.9;
export const HALF_LIVES_S: readonly number[] = [3.0, 8.0];
export const BUFFER_SHARE = 0.5;
export const RESERVE_S = 3.0;
export const STALL_DB = 20.0;
export const SWITCH_DB = 0.25;
export const LOW_BUFFER_DB = 1.0;
export const HORIZON_S = 8.0;
export const HORIZON_SEGMENTS = 12;
export const GRID_POINTS = 80;
export const PAST_DOWNLOADS = 3;
export const POLICY_NAMES = ["paper", "paper-no-cliff", "paper-literal", "paper-literal-no-cliff", "throughput", "bola", "robust-mpc"] as const;

// airgs_codec.play.ladder
export const DEFAULT_BETA = 2.0;
export const EPS_DB = 0.25;
export const CLIFF_DB = 3.0;

// airgs_codec.play.offers
export const HEADER_BYTES = 350;
export const OVER_BUDGET = 1125899906842624;

// airgs_codec.play.downloader
export const CHECK_S = 0.5;

// airgs_codec.play.player
export const REMEMBERED = 24;
export const SHORTEST_S = 1e-09;
export const LONGEST_POLL_S = 4.0;
export const POLL_S = 1.0;
export const SILENCE_S = 60.0;
export const REPLACE_GAIN_DB = 0.5;
export const SESSION = {"bufferS": 10.0, "startupS": 1.0, "resumeS": 0.5, "decodeFrameS": 0.004, "replace": true, "abandon": true} as const;

// airgs_codec.play.http
export const BUSY: readonly number[] = [429, 502, 503, 504];
export const GARBLED = ["size_mismatch", "hash_mismatch", "not_json"] as const;
export const LONGEST_PAUSE_S = 4.0;
export const LEAST_BYTES = 1024;
export const TIMEOUT_S = 8.0;
export const ATTEMPTS = 4;
export const BACKOFF_S = 0.25;
