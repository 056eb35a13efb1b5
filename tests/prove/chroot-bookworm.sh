# ./dev demo and ./dev test in a fresh bookworm chroot (root, about 40 minutes)
exec sh "$(dirname "$0")/_chroot.sh" bookworm "$@"
