// What the element loads when there is a picture, or when somebody asks for it.
export { readCameraPath } from "./play/keyframes.ts";
export { Menu } from "./ui/menu.ts";
export { default as STYLE } from "./ui/more.css";
export { Panel } from "./ui/panel.ts";
export { Split } from "./ui/split.ts";
