#!/usr/bin/env bash
# Boots Debian's kernel under software emulation (never KVM) with the conformance tests as its only program: run.sh TEST_EXECUTABLE [FILTER]
# Exit 77: the machine is not prepared (tests/vm/prepare.sh). One boot, at most LACQUER_VM_SECONDS (300).
set -euo pipefail
program=$1
filter=${2:-Vm*:Devices/*}
cache=${LACQUER_VM_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/lacquer-vm}
skip() {
  echo "SKIPPED LOUDLY: no virtual machine: $1; tests/vm/prepare.sh prepares it. The drivers were NOT tested against the kernel."
  exit 77
}
[ -f "$cache/ready" ] || skip "nothing in $cache"
command -v qemu-system-x86_64 >/dev/null || skip "no qemu-system-x86_64"
command -v cpio >/dev/null || skip "no cpio"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
root=$work/root
mkdir -p "$root"/{bin,dev,proc,sys,tmp,modules,sys}
cp "$cache/busybox" "$root/bin/busybox"
cp "$cache"/modules/* "$cache/order" "$root/modules/"
cp "$program" "$root/bin/test"
strip "$root/bin/test"
# The libraries where the program looks for them.
ldd "$program" | awk '$2 == "=>" {print $3} $1 ~ /^\// {print $1}' | while read -r library; do
  mkdir -p "$root$(dirname "$library")"
  cp -L "$library" "$root$library"
done
cat > "$root/init" <<EOF
#!/bin/busybox sh
/bin/busybox mount -t proc none /proc
/bin/busybox mount -t sysfs none /sys
/bin/busybox mount -t devtmpfs none /dev
while read -r module; do
  case \$module in vivid.ko) options="n_devs=1 node_types=0x1 input_types=0x0 num_inputs=1" ;; *) options= ;; esac
  /bin/busybox insmod /modules/\$module \$options
done < /modules/order
/bin/busybox mount -t configfs none /sys/kernel/config
export LACQUER_VM=1 HOME=/tmp
cd /tmp
/bin/test --gtest_color=no '--gtest_filter=$filter' 2>&1
echo "LACQUER_VM_EXIT=\$?"
/bin/busybox poweroff -f
EOF
chmod +x "$root/init"
(cd "$root" && find . | cpio -o -H newc --quiet) > "$work/initramfs"

status=0
timeout "${LACQUER_VM_SECONDS:-300}" qemu-system-x86_64 -M q35 -accel tcg,thread=multi -cpu max -smp 2 -m 2048 -nodefaults -display none -serial stdio -no-reboot \
  -kernel "$cache/vmlinuz" -initrd "$work/initramfs" -append "console=ttyS0 quiet loglevel=3 panic=-1 mitigations=off" \
  </dev/null 2>&1 | tr -d '\r' | tee "$work/log" || status=$?
code=$(sed -n 's/^LACQUER_VM_EXIT=//p' "$work/log")
if [ -z "$code" ]; then
  echo "the virtual machine did not finish (status $status)"
  exit 1
fi
grep -q '\[  PASSED  \] [1-9]' "$work/log" || { echo "no test ran in the virtual machine"; exit 1; }
exit "$code"
