# Sourced by the scripts that install what is missing where they may: Debian's packages, as root or with a sudo that asks nothing.

have() { command -v "$1" >/dev/null 2>&1; }

# Runs a command as root where that needs no password.
as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; elif have sudo && sudo -n true 2>/dev/null; then sudo -n "$@"; else return 1; fi
}

# install PACKAGE: by apt-get, where that is there and may.
install() {
    echo "== $1 is missing: apt-get install $1"
    have apt-get && as_root true || return 1
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q "$1" ||
        { as_root apt-get update -q && as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q "$1"; }
}

# need COMMAND PACKAGE: makes sure that COMMAND is there; returns 1 where it cannot be had.
need() {
    have "$1" || install "$2"
    have "$1"
}

# package NAME: makes sure of a Debian package where there is Debian; says nothing about other systems.
package() {
    have dpkg || return 0
    dpkg -s "$1" >/dev/null 2>&1 || install "$1"
}
