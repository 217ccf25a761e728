// The README and the pages of docs/ as pages that a browser shows.

import { existsSync } from "node:fs";
import { posix } from "node:path";
import { Marked } from "marked";
import { gfmHeadingId } from "marked-gfm-heading-id";

/**
 * Where a link of a document leads from its page: null to what the pages lack, as a source file.
 * `directory` has the files that the pages have.
 */
function addressOf(href, name, directory) {
  if (/^(#|https?:)/.test(href)) {
    return href;
  }
  const address = href.replace(/\.md(?=#|$)/, ".html");
  const file = posix.join(directory, posix.dirname(name), address.split("#")[0]);
  return existsSync(file) ? address : null;
}

/**
 * A document's page. `name` is its path in the repository, as in "docs/web.md"; `directory` has the
 * other pages and their pictures, or a link to them becomes words.
 */
export function documentPage(name, text, directory) {
  const marked = new Marked(gfmHeadingId(), {
    renderer: {
      html: () => "",
      // False leaves the rest to marked.
      link(link) {
        link.href = addressOf(link.href, name, directory);
        return link.href === null && this.parser.parseInline(link.tokens);
      },
      image(image) {
        image.href = addressOf(image.href, name, directory);
        return image.href === null && `[Picture: ${this.parser.parseInline(image.tokens)}]`;
      },
    },
  });
  const top = "../".repeat(name.split("/").length - 1);
  const [, title] = /^# (.*)/m.exec(text);
  // What is wider than the screen is scrolled, by keyboard too.
  const scrolled = marked.parse(text).replace(/<(pre|table)>/g, '<$1 tabindex="0">');
  return `<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8" />
<meta name="viewport" content="width=device-width, initial-scale=1" />
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'self'; img-src 'self'" />
<title>${title}</title>
<link rel="icon" href="${top}icon.svg" />
<link rel="stylesheet" href="${top}app.css" />
</head>
<body>
<main class="document">
<nav aria-label="Pages"><a href="${top}index.html">The node in this browser</a> <a href="${top}docs/README.html">Documents</a></nav>
${scrolled}</main>
</body>
</html>
`;
}
