// The groups: who belongs to each, and whether they are together.

/** Builds the panel once; the returned function shows the groups in a state. */
function createBuildingPanel(select) {
  const rows = episode.groups.map(({ name, members }, group) => {
    const look = html("span", { class: "look" });
    const chips = html("span", { class: "chips" }, ...members.map(chip));
    const button = html("button", { type: "button" }, groupIcon(group), name, look, chips);
    button.addEventListener("click", () => select({ building: group }));
    return { button, look };
  });
  byId("groups").append(...rows.map(({ button }) => button));

  return function showGroups(view) {
    const state = episode.states[view.at];
    rows.forEach(({ button, look }, group) => {
      button.setAttribute("aria-pressed", group === view.building);
      look.textContent = state.gathered[group] ? "together" : "apart";
      look.classList.toggle("is-gathered", state.gathered[group]);
    });
    byId("group-title").replaceChildren(groupIcon(view.building), `Group ${episode.groups[view.building].name}`);
    byId("group-text").textContent = groupText(view, state);
  };
}

function groupText(view, state) {
  const { members } = episode.groups[view.building];
  if (members.length === 0) {
    return "nobody belongs to it: it counts as together";
  }
  const where = cellList(cellsOf(state, view.building));
  const count = `${members.length} agent${members.length === 1 ? "" : "s"}`;
  const since = state.gathered[view.building] ? `, since step ${gatheredSince(view)}` : "";
  return `${count} in ${where}${since}`;
}

/** The first state of the stretch in which the group is together. */
function gatheredSince(view) {
  let at = view.at;
  while (at > 0 && episode.states[at - 1].gathered[view.building]) {
    at -= 1;
  }
  return at;
}
