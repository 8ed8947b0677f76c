# shellcheck shell=bash
# What the scripts beside this file share. To be sourced, not run.

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"

# Outside the checkout, so that a fresh clone finds Bevy compiled already.
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-${HOME:?HOME is not set}/.cache/bevy_tessera/target}"

say() {
    printf '%s\n' "$*" >&2
}

fail() {
    say "$*"
    exit 1
}

# Installs Debian packages; elsewhere says what to install, in the words of the second argument.
# install_packages "gcc libc6-dev" "a C compiler and linker" "Fedora: …"
install_packages() {
    local packages="$1" what="$2" elsewhere="$3"
    local -a as_root=()
    if ! command -v apt-get >/dev/null; then
        fail "$what is missing. Please install it, then run this again. $elsewhere"
    fi
    if [ "$(id -u)" -ne 0 ]; then
        if ! command -v sudo >/dev/null; then
            fail "$what is missing. As root: apt-get install $packages"
        fi
        as_root=(sudo)
        [ -t 0 ] || as_root+=(-n)
    fi
    say "$what is missing: installing $packages"
    # Without package lists, as in a fresh container, nothing can be installed; with lists that
    # can't be refreshed just now something often can.
    "${as_root[@]}" apt-get update -q >&2 || say "the package lists could not be refreshed"
    # shellcheck disable=SC2086 # several packages, several words
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -q -y --no-install-recommends $packages >&2 \
        || fail "$packages could not be installed"
}

# Cargo, of whatever version: Cargo.toml names the one that is needed, and Cargo says so.
need_cargo() {
    if ! command -v cargo >/dev/null && [ -x "${HOME:-}/.cargo/bin/cargo" ]; then
        PATH="$HOME/.cargo/bin:$PATH"
    fi
    if ! command -v cargo >/dev/null; then
        say "Rust is missing. Please install it, then run this again:"
        fail "  curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh"
    fi
    local component
    for component in "$@"; do
        cargo "$component" --version >/dev/null 2>&1 \
            || fail "cargo $component is missing: rustup component add rustfmt clippy"
    done
}

# Writes the Vulkan probe to $1; fails where C can't be compiled and linked.
build_vulkan_probe() {
    cc -O1 -o "$1" "$root/scripts/vulkan_probe.c" -ldl 2>/dev/null
}

# A C linker, for Rust and for the few crates that build C; and on Linux a Vulkan device.
need_linker_and_vulkan() {
    [ "$(uname -s)" = Linux ] || return 0
    # Not local: the trap runs when the function has returned.
    probe_folder="$(mktemp -d)"
    trap 'rm -rf "$probe_folder"' EXIT
    local probe="$probe_folder/vulkan_probe"
    if ! build_vulkan_probe "$probe"; then
        install_packages "gcc libc6-dev" "a C compiler and linker" \
            "Fedora: gcc glibc-devel. Arch: gcc. openSUSE: gcc glibc-devel."
        build_vulkan_probe "$probe" || fail "cc does not compile $root/scripts/vulkan_probe.c"
    fi
    if ! "$probe" >/dev/null; then
        install_packages "libvulkan1 mesa-vulkan-drivers" \
            "a Vulkan device (the loader, or a driver that finds one)" \
            "Fedora: vulkan-loader mesa-vulkan-drivers. Arch: vulkan-icd-loader vulkan-swrast. \
openSUSE: libvulkan1 libvulkan_lvp."
        "$probe" >/dev/null || fail "there is still no Vulkan device"
    fi
    "$probe" >&2
    rm -rf "$probe_folder"
    trap - EXIT
}

# Several checkouts may share a target directory, and Cargo tells a path package's files by their
# path in the workspace and their time alone: what another checkout built may pass for fresh here.
# Removes this package's own artifacts, never the dependencies', where another checkout came last
# or where the first argument is "always".
forget_other_checkouts() {
    local mark="$CARGO_TARGET_DIR/.checkout"
    mkdir -p "$CARGO_TARGET_DIR"
    if [ "${1:-}" = always ] || [ "$(cat "$mark" 2>/dev/null)" != "$root" ]; then
        local profile
        for profile in dev release; do
            cargo clean --quiet --manifest-path "$root/Cargo.toml" --locked \
                -p bevy_tessera --profile "$profile"
        done
        printf '%s\n' "$root" >"$mark"
    fi
}
