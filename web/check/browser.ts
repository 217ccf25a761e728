// The cross-check for check/browser.mjs, which calls it in Chromium.

import { trace } from "./trace";

Object.assign(window, { trace });
