// What is there beside pages of recorded episodes, and a page that begins anew where its address names another episode.

show.push(createDeeds(), createBits());

function isOther(name, own) {
  const address = new URLSearchParams(location.hash.slice(1));
  return address.has(name) && address.get(name) !== String(own);
}

window.addEventListener("hashchange", () => {
  if (isOther("seed", seed) || isOther("episode", number)) {
    location.reload();
  }
});
refresh();
requestAnimationFrame(() => {
  document.documentElement.dataset.firstFrame = Math.round(performance.now());
});
