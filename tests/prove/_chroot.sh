# Proves ./dev in a fresh Debian: sh tests/prove/_chroot.sh SUITE [demo] [test]
#
# Needs root. A chroot made by `debootstrap --variant=minbase SUITE` gets git, ca-certificates and
# this machine's package-source settings (apt sources, CA certificates, pip configuration), a clone
# of HEAD, /proc, /dev and /dev/shm: nothing else. Then ./dev demo and ./dev test run in it, timed.
# A minbase tree kept at $MATIERE_CHROOTS/base-SUITE is reused, otherwise debootstrap makes one.
set -eu

suite=$1
shift
[ $# -gt 0 ] || set -- demo test
root=$(cd "$(dirname "$0")/../.." && pwd)
store=${MATIERE_CHROOTS:-$root/prove-out/chroots}
base=$store/base-$suite
work=$store/run-$suite
out=$root/prove-out/chroot-$suite
result=$out/result.txt

die() {
    printf 'chroot-%s: error: %s\n' "$suite" "$*" >&2
    exit 1
}

[ "$(id -u)" = 0 ] || die "run as root (it mounts and changes root)"

# Everything that mounts runs in a mount namespace of its own: nothing stays mounted afterwards.
if [ "${MATIERE_IN_NAMESPACE:-}" != yes ]; then
    MATIERE_IN_NAMESPACE=yes exec unshare --mount --propagation private sh "$0" "$suite" "$@"
fi

say() { printf '%s  %s\n' "$(date -u +%H:%M:%S)" "$*" | tee -a "$result"; }

apt_uri() {
    cat /etc/apt/sources.list.d/*.sources /etc/apt/sources.list 2>/dev/null |
        sed -n 's/^URIs: *\([^ ]*\).*/\1/p; s/^deb *\([^ [][^ ]*\).*/\1/p' | head -n 1
}

make_base() {
    [ ! -d "$base/usr" ] || return 0
    command -v debootstrap >/dev/null || die "apt-get install debootstrap first"
    mkdir -p "$store"
    debootstrap --variant=minbase "$suite" "$base.part" "$(apt_uri)" >"$out/debootstrap.log" 2>&1 ||
        die "debootstrap failed, see $out/debootstrap.log"
    mv "$base.part" "$base"
}

# Copies the package-source settings of this machine, with the suite's name put in.
copy_settings() {
    . /etc/os-release
    rm -f "$work"/etc/apt/sources.list "$work"/etc/apt/sources.list.d/*
    for file in /etc/apt/sources.list /etc/apt/sources.list.d/*.list \
        /etc/apt/sources.list.d/*.sources; do
        [ ! -f "$file" ] || sed "s/\b$VERSION_CODENAME\b/$suite/g" "$file" >"$work$file"
    done
    for file in /etc/apt/apt.conf.d/*; do
        grep -q '^Acquire' "$file" && cp "$file" "$work$file"
    done
    cp -L /etc/resolv.conf /etc/hosts "$work/etc/"
    [ ! -f /etc/pip.conf ] || cp /etc/pip.conf "$work/etc/"
    mkdir -p "$work/etc/ssl/certs" "$work/usr/local/share/ca-certificates"
    cp -L /etc/ssl/certs/ca-certificates.crt "$work/etc/ssl/certs/"
    cp -L /etc/ssl/certs/ca-certificates.crt "$work/etc/machine-certificates.pem"
    cp -RL /usr/local/share/ca-certificates/. "$work/usr/local/share/ca-certificates/"
    git -C "$root" bundle create -q "$work/root/matiere.bundle" HEAD main
}

# The environment inside: settings of pip, certificates and proxies, and nothing else of ours.
inside() {
    settings=$(env | grep -E '^(PIP_[A-Z_]*|https?_proxy|no_proxy|HTTPS?_PROXY|NO_PROXY)=' |
        grep -v '^PIP_\(FIND_LINKS\|CERT\)=' || true)
    pem=/etc/machine-certificates.pem
    # shellcheck disable=SC2086
    chroot "$work" env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 TERM=dumb \
        SSL_CERT_FILE=$pem PIP_CERT=$pem REQUESTS_CA_BUNDLE=$pem GIT_SSL_CAINFO=$pem \
        $settings sh -c "$1" </dev/null
}

# Ends what an earlier, interrupted run left running in the chroot.
end_leftovers() {
    for process in /proc/[0-9]*; do
        [ "$(readlink "$process/root" 2>/dev/null)" != "$work" ] ||
            kill -9 "${process#/proc/}" 2>/dev/null || true
    done
}

mkdir -p "$out"
: >"$result"
make_base
say "commit $(git -C "$root" rev-parse --short HEAD), suite $suite, $(nproc) CPUs"
end_leftovers
rm -rf --one-file-system "$work"
cp -a "$base" "$work"
copy_settings
mount -t proc proc "$work/proc"
mount --rbind /dev "$work/dev"

inside 'apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y \
    --no-install-recommends git ca-certificates' >"$out/apt.log" 2>&1 ||
    die "installing git failed, see $out/apt.log"
inside 'git clone -q -b main /root/matiere.bundle /root/matiere' >>"$out/apt.log" 2>&1 ||
    die "git clone failed, see $out/apt.log"
say "$(inside '. /etc/os-release; echo "$PRETTY_NAME"'), packages at the start: $(
    inside 'dpkg-query -W | wc -l')"

failed=
for step in "$@"; do
    log=$out/$(printf '%s' "$step" | tr -c 'a-z\n' '_').log
    begun=$(date +%s)
    status=0
    inside "cd /root/matiere && ./dev $step" >"$log" 2>&1 || status=$?
    say "./dev $step: exit $status after $(($(date +%s) - begun)) s"
    [ $status = 0 ] || { failed="$failed $step"; tail -n 30 "$log" | tee -a "$result"; }
    tail -n 1 "$log" | tee -a "$result"
done
say "$(inside 'python3 --version; g++ --version | head -n 1; dpkg-query -W "libembree*-[34]"' |
    tr '\n' ' ')"
[ ! -d "$work/root/matiere/demo-out" ] || {
    rm -rf "$out/demo-out"
    cp -r "$work/root/matiere/demo-out" "$out/demo-out"
}
[ -z "$failed" ] || die "failed:$failed (logs in $out)"
