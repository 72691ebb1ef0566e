// Search the texts of all pages, which `docs/extensions/search_texts.py` writes. Nothing is fetched,
// so that the search also works for pages that are opened from a folder.
"use strict";

// How much more a word counts in the title of a page or of a section than in its text, and a query whose
// words stand beside each other.
const IN_TITLE = 6, IN_HEADING = 2, AS_PHRASE = 2;
const SATURATION = 3;  // occurrences of a word that count half as much as very many
const SHOWN = 240;  // characters of text around a match
const stemmer = new Stemmer(), stems = new Map();

function stemOf(word) {
  const lower = word.toLowerCase();
  if (!stems.has(lower)) stems.set(lower, stemmer.stemWord(lower));
  return stems.get(lower);
}

// The words of a text, each with its stem and its place.
const wordsOf = text => [...text.matchAll(/[\p{L}\p{N}_]+/gu)].map(({0: word, index}) => ({word, index, stem: stemOf(word)}));
const phraseOf = text => ` ${wordsOf(text).map(each => each.stem).join(" ")} `;

const pages = TEXTS.pages.map(page => ({
  ...page,
  phrase: phraseOf(page.title),
  sections: page.sections.map(([title, anchor, text, names]) => ({title, anchor, text, names: names.map(stemOf), heading: phraseOf(title), words: wordsOf(text)})),
}));
pages.forEach(page => {
  page.counts = new Map();
  page.sections.forEach(section => section.words.forEach(({stem}) => page.counts.set(stem, (page.counts.get(stem) ?? 0) + 1)));
});
const vocabulary = new Set(pages.flatMap(page => [...page.counts.keys(), ...page.phrase.trim().split(" "),
  ...page.sections.flatMap(section => section.heading.trim().split(" "))]));

// The stems that a word of the query stands for: its own, or those that begin with a word typed in part.
function meant({word, stem}) {
  if (vocabulary.has(stem)) return [stem];
  return word.length > 2 ? [...vocabulary].filter(each => each.startsWith(word.toLowerCase())) : [];
}

const sum = numbers => numbers.reduce((a, b) => a + b, 0);

// Whether a title has a word: 1 if it has no other, and less the more others it has.
function has(phrase, terms) {
  return terms.some(stem => phrase.includes(` ${stem} `)) ? (1 + 1 / phrase.trim().split(" ").length) / 2 : 0;
}

// Whether the title of a section has a word, or one of its tables describes it as a name.
const isAbout = (section, terms) => Math.max(has(section.heading, terms), Number(section.names.some(stem => terms.includes(stem))));

// Rate a page for a query: rare words count more, and each further occurrence less than the one before.
function rate(page, query) {
  const found = query.terms.map((terms, i) => {
    const count = sum(terms.map(stem => page.counts.get(stem) ?? 0));
    return query.rarity[i] * (count / (count + SATURATION) + IN_TITLE * has(page.phrase, terms)
      + IN_HEADING * Math.max(...page.sections.map(section => isAbout(section, terms))));
  });
  const together = query.terms.length > 1 && (page.phrase.includes(query.phrase)
    || page.sections.some(section => section.heading.includes(query.phrase) || phraseOf(section.text).includes(query.phrase)));
  return {page, known: found.filter(x => x > 0).length, score: sum(found) * page.weight * (together ? AS_PHRASE : 1)};
}

// The section of a page that a query fits best, and the place of its words there.
function bestSection(page, query) {
  const rated = page.sections.map(section => {
    const inside = query.terms.map((terms, i) => {
      const count = section.words.filter(({stem}) => terms.includes(stem)).length;
      return query.rarity[i] * (count / (count + SATURATION) + IN_HEADING * isAbout(section, terms));
    });
    return {section, score: sum(inside)};
  });
  const {section} = rated.reduce((best, each) => each.score > best.score ? each : best);
  const place = section.words.find(({stem}) => query.terms.some(terms => terms.includes(stem)))?.index ?? 0;
  return {section, place};
}

function make(tag, attributes, ...content) {
  const made = Object.assign(document.createElement(tag), attributes);
  made.append(...content);
  return made;
}

// A text with the words of the query marked.
function marked(text, query) {
  const known = new Set(query.terms.flat()), parts = [];
  let end = 0;
  wordsOf(text).filter(({stem}) => known.has(stem)).forEach(({word, index}) => {
    parts.push(text.slice(end, index), make("mark", {}, word));
    end = index + word.length;
  });
  return [...parts, text.slice(end)];
}

function around(text, place) {
  const from = place < SHOWN / 2 ? 0 : text.indexOf(" ", place - SHOWN / 2) + 1;
  const to = text.length - from <= SHOWN ? text.length : text.lastIndexOf(" ", from + SHOWN);
  return `${from > 0 ? "… " : ""}${text.slice(from, to)}${to < text.length ? " …" : ""}`;
}

const titleOf = Object.fromEntries(pages.map(({page, title}) => [page, title]));

function search(text) {
  const words = wordsOf(text).filter(({word}, _, all) => all.length === 1 || !stopwords.has(word.toLowerCase()));
  const terms = words.map(meant);
  const rarity = terms.map(each => Math.log(1 + pages.length / (1 + pages.filter(page => has(page.phrase, each) || each.some(stem => page.counts.has(stem))).length)));
  const query = {terms, rarity, phrase: phraseOf(text)};
  const answers = TEXTS.synonyms.filter(({words}) => words.some(word => query.phrase.includes(phraseOf(word))))
    .map(({page, anchor, text}) => ({page, anchor, text, title: titleOf[page]}));
  const rated = pages.map(page => rate(page, query)).filter(({known}) => known > 0);
  const most = Math.max(...rated.map(({known}) => known));
  const results = rated.filter(({known}) => known === most).sort((a, b) => b.score - a.score).map(({page}) => {
    const {section, place} = bestSection(page, query), first = section === page.sections[0];
    return {page: page.page, anchor: first ? "" : `#${section.anchor}`, text: around(section.text, place),
      title: first ? page.title : `${page.title}: ${section.title}`};
  });
  const answered = new Set(answers.map(({page}) => page));
  const shown = [...answers, ...results.filter(({page}) => !answered.has(page))];
  return shown.map(({page, anchor, title, text}) => make("li", {},
    make("a", {href: `${page}.html${anchor}`}, title), make("p", {}, ...marked(text, query))));
}

const asked = new URLSearchParams(location.search).get("q")?.trim();
document.querySelectorAll("input[name=q]").forEach(input => { input.value = asked ?? ""; });
if (asked) {
  const found = search(asked);
  document.getElementById("results").replaceChildren(...found);
  document.getElementById("found").textContent = found.length ? `${found.length} ${found.length > 1 ? "pages, the best first" : "page"}.`
    : "No page has these words. The glossary and the case file list the names that sphrom uses.";
}
