// How the search of the site ranks: as Sphinx does, but a page for readers comes before the page of a name or a command
// that has the same words. A class that is typed as it is called still comes first.
const SHARES = [
  [/^(start|guide|howto)\//, 2],
  [/^(reference\/api|reference\/commands|reference\/options|gallery)/, 0.25],
  [/^appendix\//, 0.5],
];

var Scorer = {
  score: ([docname, name, , , score, , kind]) => {
    if (kind === "object" && score >= Scorer.objNameMatch + Scorer.objPrio[1])
      return /\.[A-Z]\w*$/.test(name) ? 4 * score : score;
    const [, share] = SHARES.find(([pages]) => pages.test(docname)) ?? [null, 1];
    return share * score;
  },
  // The values of Sphinx.
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
