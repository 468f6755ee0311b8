// Opens report pages in Chromium and checks what only a browser knows:
//
//   node check.mjs [--out FOLDER] [--chromium PROGRAM] PAGE.html...
//
// Each page is opened at 1280 and 390 pixels, in light and in dark, with scripts on and off, and without a network:
//   - nothing is requested but the page itself, and nothing is written to the console;
//   - nothing is cut off: the page is as wide as its window, and what is wider scrolls in a frame of its own;
//   - no two texts lie on each other, and every text of a drawing lies inside of it (boxes are compared, not pixels);
//   - every figure has a size and draws something;
//   - every link leads somewhere: to a part of the page, or to a file beside it;
//   - axe-core finds no serious violation.
// With --out, screenshots are kept, with all folded parts open and closed. It ends with 1 where anything was found.
//
// Chromium comes from the system (`apt-get install chromium`), the rest by `npm install` in this folder.

import { existsSync, mkdirSync } from "node:fs";
import { createRequire } from "node:module";
import { basename, dirname, join, resolve } from "node:path";
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { parseArgs } from "node:util";
import puppeteer from "puppeteer-core";

const WIDTHS = [1280, 390];
const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

const { values, positionals } = parseArgs({
  options: { out: { type: "string" }, chromium: { type: "string", default: "/usr/bin/chromium" } },
  allowPositionals: true,
});
if (positionals.length === 0) {
  console.error("usage: node check.mjs [--out FOLDER] [--chromium PROGRAM] PAGE.html...");
  process.exit(2);
}

// Runs in the page: everything that can be told from the boxes of its elements.
function measure() {
  const found = [];
  const name = (element) => {
    const text = (element.textContent || "").trim().replace(/\s+/g, " ").slice(0, 50);
    return `<${element.tagName.toLowerCase()}> "${text}"`;
  };
  const scrolls = (element) => {
    for (let at = element; at && at !== document.body; at = at.parentElement) {
      const overflow = getComputedStyle(at).overflowX;
      if (overflow === "auto" || overflow === "scroll") return true;
    }
    return false;
  };
  const shown = (element) => {
    const box = element.getBoundingClientRect();
    return box.width > 0 && box.height > 0 && element.checkVisibility();
  };
  if (document.documentElement.scrollWidth > window.innerWidth + 1) {
    found.push(`the page is ${document.documentElement.scrollWidth} pixels wide in a window of ${window.innerWidth}`);
  }
  for (const element of document.querySelectorAll("body *")) {
    if (!shown(element) || element.closest("svg") !== null || scrolls(element)) continue;
    const box = element.getBoundingClientRect();
    if (box.left < -1 || box.right > window.innerWidth + 1) found.push(`${name(element)} is cut off at the side`);
  }

  const overlaps = (boxes) => {
    boxes.sort((a, b) => a.box.top - b.box.top);
    for (let i = 0; i < boxes.length; i += 1) {
      for (let j = i + 1; j < boxes.length && boxes[j].box.top < boxes[i].box.bottom - 2; j += 1) {
        const [a, b] = [boxes[i].box, boxes[j].box];
        const [x, y] = [Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top)];
        if (x > 2 && y > 2) found.push(`${name(boxes[i].element)} and ${name(boxes[j].element)} overlap`);
      }
    }
  };
  // The lines of text of the page itself; an element that holds others' text counts by its own only.
  const texts = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const parent = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || parent.closest("svg,style,title") || !shown(parent)) continue;
    const range = document.createRange();
    range.selectNodeContents(walker.currentNode);
    for (const box of range.getClientRects()) texts.push({ element: parent, box });
  }
  overlaps(texts.filter((text) => text.box.width > 0));

  for (const svg of document.querySelectorAll("svg")) {
    if (!shown(svg)) continue;
    const frame = svg.getBoundingClientRect();
    const inside = [...svg.querySelectorAll("text")].map((element) => ({ element, box: element.getBoundingClientRect() }));
    for (const { element, box } of inside) {
      if (box.left < frame.left - 1 || box.right > frame.right + 1 || box.top < frame.top - 1 || box.bottom > frame.bottom + 1) {
        found.push(`${name(element)} leaves its drawing "${svg.getAttribute("aria-label")}"`);
      }
    }
    overlaps(inside);
  }
  for (const figure of document.querySelectorAll("figure")) {
    if (!figure.checkVisibility()) continue;
    const [svg, image] = [figure.querySelector("svg"), figure.querySelector("img")];
    if (image && !(image.complete && image.naturalWidth > 0)) found.push(`${name(figure)}: its image does not load`);
    if (svg) {
      const drawn = [...svg.querySelectorAll("path")].filter((path) => path.getTotalLength() > 0 || path.getAttribute("d"));
      if (svg.getBoundingClientRect().height < 40 || drawn.length < 2) found.push(`${name(figure)} draws nothing`);
    }
  }
  const links = [...document.querySelectorAll("a[href]")].map((link) => link.getAttribute("href"));
  for (const link of links.filter((link) => link.startsWith("#"))) {
    if (!document.getElementById(decodeURIComponent(link.slice(1)))) found.push(`the link ${link} leads nowhere`);
  }
  return { found, links: links.filter((link) => !link.startsWith("#")) };
}

async function check(browser, file, width, scheme, scripts) {
  const found = [];
  const page = await browser.newPage();
  await page.setBypassCSP(true);
  await page.setViewport({ width, height: 900, deviceScaleFactor: width < 500 ? 2 : 1, isMobile: width < 500 });
  await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
  await page.setJavaScriptEnabled(scripts);
  page.on("console", (message) => found.push(`console: ${message.text()}`));
  page.on("pageerror", (error) => found.push(`error: ${error.message}`));
  const address = pathToFileURL(resolve(file)).href;
  page.on("request", (request) => {
    const url = request.url();
    if (url !== address && !url.startsWith("data:")) found.push(`asks for ${url}`);
  });
  await page.goto(address);
  await page.setOfflineMode(true);
  const keep = async (state) => {
    if (!values.out || !scripts) return;
    const path = join(values.out, `${basename(dirname(resolve(file)))}-${width}-${scheme}-${state}.png`);
    await page.screenshot({ path, fullPage: true });
  };
  for (const state of ["closed", "open"]) {
    if (state === "open") {
      await page.evaluate(() => document.querySelectorAll("details").forEach((part) => (part.open = true)));
    }
    const measured = await page.evaluate(measure);
    found.push(...measured.found.map((text) => `${state}: ${text}`));
    for (const link of measured.links) {
      if (!existsSync(join(dirname(file), decodeURIComponent(link)))) found.push(`the link ${link} leads nowhere`);
    }
    await keep(state);
  }
  if (scripts) {
    await page.evaluate(axe);
    const { violations } = await page.evaluate(() => window.axe.run());
    for (const { id, impact, help, nodes } of violations) {
      const text = `axe: ${impact}: ${id}: ${help}: ${nodes.length} places, the first ${nodes[0].html.slice(0, 120)}`;
      if (impact === "serious" || impact === "critical") found.push(text);
      else console.log(`${file} at ${width}: ${text}`);
    }
  }
  await page.close();
  return [...new Set(found)];
}

if (values.out) mkdirSync(values.out, { recursive: true });
const browser = await puppeteer.launch({
  executablePath: values.chromium,
  args: ["--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"],
});
let wrong = 0;
for (const file of positionals) {
  for (const width of WIDTHS) {
    for (const [scheme, scripts] of [["light", true], ["dark", true], ["light", false]]) {
      const found = await check(browser, file, width, scheme, scripts);
      wrong += found.length;
      const how = `${file} at ${width}, ${scheme}, scripts ${scripts ? "on" : "off"}`;
      console.log(found.length === 0 ? `ok: ${how}` : `${how}:`);
      for (const text of found.slice(0, 40)) console.log(`  ${text}`);
      if (found.length > 40) console.log(`  and ${found.length - 40} more`);
    }
  }
}
await browser.close();
process.exit(wrong === 0 ? 0 : 1);
