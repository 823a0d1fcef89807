// What the element loads when there is a picture, when somebody asks for it, or when something went wrong.
export { fetchCameraPath } from "./play/keyframes.ts";
export { OTHERS as POLICIES } from "./play/policies/named.ts";
export { copyLink, goTo, momentOf } from "./ui/desk.ts";
export { Gestures } from "./ui/gestures.ts";
export { helpOf, keysCard, listenToKeys } from "./ui/keys.ts";
export { Menu } from "./ui/menu.ts";
export { default as STYLE } from "./ui/more.css";
export { Panel } from "./ui/panel.ts";
export { Scrub } from "./ui/scrub.ts";
export { Sharpness } from "./ui/sharpness.ts";
export { FullScreen } from "./ui/shell.ts";
export { Split } from "./ui/split.ts";
export { pointAt, subjectAt } from "./ui/subject.ts";
export { card, lacking, troubleOf } from "./ui/trouble.ts";
