/** The page: its header, and the view of the address. */

import { header } from "./header.js";
import { start } from "./router.js";
import { applyTheme } from "./theme.js";

applyTheme();
header(document.getElementById("header"));
start(document.getElementById("main"));
